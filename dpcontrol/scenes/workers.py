"""Where a campaign's jobs run: processes of this machine, or a Dask cluster; finished jobs come back in any order.

A worker that dies takes its job along; the job is run again elsewhere. Local workers are made anew; Dask does that
itself.
"""

import multiprocessing
import os
import signal
import threading
from collections.abc import Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager

from dpcontrol.foundation.errors import GoalMissed, InputError
from dpcontrol.scenes.campaign_jobs import Job, Row, run_job

ANSWERS_WITHIN = "10s"
"""How long a cluster may take to answer."""
ATTEMPTS = 4
"""How often a job is begun before its workers' deaths count as its own fault."""


def default_workers() -> int:
    """Return the number of processors this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def run_here(jobs: Sequence[Job]) -> Iterator[tuple[Job, list[Row]]]:
    """Run jobs one after the other in this process."""
    for job in jobs:
        yield job, run_job(job)


@contextmanager
def _deaf() -> Iterator[None]:
    """Let Ctrl-C wait; processes that are started meanwhile never hear it: it is for the one that started them."""
    heard: list[int] = []
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    # Another thread may still be given the signal, and the main one would leave a process half started.
    in_main = threading.current_thread() is threading.main_thread()
    handler = signal.signal(signal.SIGINT, lambda number, _: heard.append(number)) if in_main else None
    try:
        yield
    finally:
        if in_main:
            signal.signal(signal.SIGINT, handler)
        signal.pthread_sigmask(signal.SIG_SETMASK, before)
    if heard:
        signal.raise_signal(signal.SIGINT)


def run_locally(jobs: Sequence[Job], workers: int) -> Iterator[tuple[Job, list[Row]]]:
    """Run jobs in `workers` processes; where the caller is interrupted or takes no more, those under way are ended.

    Raises:
        InputError, GoalMissed: as `run_job`; the latter also when a job's worker died again and again.
    """
    if workers == 1 or len(jobs) == 1:
        yield from run_here(jobs)
        return
    left = list(jobs)
    for _ in range(ATTEMPTS):
        done: set[str] = set()
        others = set(multiprocessing.active_children())
        # Forked processes would share heyoka's and casadi's threads in an unknown state.
        pool = ProcessPoolExecutor(workers, mp_context=multiprocessing.get_context("spawn"))
        try:
            with _deaf():
                running = {pool.submit(run_job, job): job for job in left}
            while running:
                finished, _ = wait(running, return_when=FIRST_COMPLETED)
                for future in finished:
                    job = running.pop(future)
                    rows = future.result()
                    done.add(job.key)
                    yield job, rows
            return
        except BrokenProcessPool:
            left = [job for job in left if job.key not in done]
        except BaseException:
            for worker in set(multiprocessing.active_children()) - others:
                worker.terminate()
            raise
        finally:
            pool.shutdown(wait=False, cancel_futures=True)
    raise GoalMissed(
        f"the campaign's workers died {ATTEMPTS} times, with {len(left)} jobs undone; is there enough memory? Finished "
        "jobs are kept: run the same command again, with fewer --workers"
    )


def run_on_cluster(jobs: Sequence[Job], address: str) -> Iterator[tuple[Job, list[Row]]]:
    """Run jobs on the Dask cluster whose scheduler answers at `address`.

    Raises:
        InputError: distributed is not installed, nothing answers there, or the cluster has no workers.
        GoalMissed: a job's workers died again and again.
    """
    try:
        from distributed import Client, KilledWorker, as_completed
    except ImportError as error:
        raise InputError(
            f"--scheduler {address}: the package distributed is not installed; pip install 'dpcontrol[cluster]'"
        ) from error
    try:
        client = Client(address, timeout=ANSWERS_WITHIN)
    except (OSError, TimeoutError, ValueError) as error:
        raise InputError(
            f"--scheduler {address}: no Dask scheduler answers there; start one with `dask scheduler`"
        ) from error
    with client:
        if not client.scheduler_info()["workers"]:
            raise InputError(
                f"--scheduler {address}: the cluster has no workers; start one with `dask worker {address}`"
            )
        futures = {client.submit(run_job, job, key=f"dpcontrol-{job.key}", retries=ATTEMPTS): job for job in jobs}
        try:
            for future in as_completed(futures):
                try:
                    rows = future.result()
                except KilledWorker as error:
                    raise GoalMissed(
                        f"the cluster's workers died again and again on one job ({error}); finished jobs are kept"
                    ) from error
                yield futures[future], rows
        finally:
            client.cancel(list(futures))
