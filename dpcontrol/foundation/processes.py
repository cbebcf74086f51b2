"""Work done in several processes of this machine, or on a Dask cluster; finished pieces come back in any order.

A process that dies takes its piece along; processes are made anew and the piece is done again. Where the one that
started them dies, they end.
"""

import multiprocessing
import multiprocessing.connection
import os
import signal
import threading
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, CancelledError, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager, suppress
from itertools import islice
from typing import TYPE_CHECKING, Protocol, TypeVar

from dpcontrol.foundation.errors import GoalMissed, InputError

if TYPE_CHECKING:
    from distributed import Client, Future

Piece = TypeVar("Piece")
Done = TypeVar("Done")

ATTEMPTS = 4
"""How often a piece is begun before its processes' deaths count as its own fault."""


def processors() -> int:
    """Return the number of processors this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def in_processes(
    function: Callable[[Piece], Done], pieces: Sequence[Piece], workers: int, *, remedy: str
) -> Iterator[tuple[Piece, Done]]:
    """Yield each piece with what `function`, a module's own, returns of it, from `workers` processes.

    In this process, one after the other, where one worker or one piece is all there is. Where the caller is interrupted
    or takes no more, processes under way are ended.

    Raises:
        GoalMissed: a piece's process died again and again; `remedy` ends the sentence.
    """
    if workers == 1 or len(pieces) == 1:
        for piece in pieces:
            yield piece, function(piece)
        return
    left = list(range(len(pieces)))
    for _ in range(ATTEMPTS):
        done: set[int] = set()
        others = set(multiprocessing.active_children())
        # Forked processes would share heyoka's and casadi's threads in an unknown state.
        context = multiprocessing.get_context("spawn")
        pool = ProcessPoolExecutor(workers, mp_context=context, initializer=end_with_parent)
        try:
            with ignoring_interrupts():
                running = {pool.submit(function, pieces[k]): k for k in left}
            while running:
                finished, _ = wait(running, return_when=FIRST_COMPLETED)
                for future in finished:
                    k = running.pop(future)
                    result = future.result()
                    done.add(k)
                    yield pieces[k], result
            return
        except BrokenProcessPool:
            left = [k for k in left if k not in done]
        except BaseException:
            for worker in set(multiprocessing.active_children()) - others:
                worker.terminate()
            raise
        finally:
            pool.shutdown(wait=False, cancel_futures=True)
    raise GoalMissed(f"workers died {ATTEMPTS} times, with {len(left)} jobs undone; is there enough memory? {remedy}")


def end_with_parent() -> None:
    """End this process, started by `multiprocessing`, as soon as the one that started it has ended, however it did.

    A thread waits for it: compiled code lets threads run, and the kernel's own death signal is Linux's alone and comes
    when the parent's thread ends.
    """
    parent = multiprocessing.parent_process()
    if parent is not None:
        threading.Thread(target=_exit_after, args=(parent.sentinel,), daemon=True).start()


def _exit_after(sentinel: int) -> None:
    multiprocessing.connection.wait([sentinel])
    os._exit(1)


@contextmanager
def ignoring_interrupts() -> Iterator[None]:
    """Delay Ctrl-C until the block ends; processes started in it ignore it, as it is for the one that started them."""
    noted: list[int] = []
    # Windows has no masks; the handler alone delays it there.
    masks = hasattr(signal, "pthread_sigmask")
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT}) if masks else ()
    # Another thread may still be given the signal, and the main one would leave a process half started.
    in_main = threading.current_thread() is threading.main_thread()
    handler = signal.signal(signal.SIGINT, lambda number, _: noted.append(number)) if in_main else None
    try:
        yield
    finally:
        if in_main:
            signal.signal(signal.SIGINT, handler)
        if masks:
            signal.pthread_sigmask(signal.SIG_SETMASK, before)
    if noted:
        signal.raise_signal(signal.SIGINT)


ANSWERS_WITHIN = "10s"
"""How long a cluster may take to answer."""
BACK_WITHIN = 120.0
"""s: how long a scheduler that was lost may take to be there again, with workers."""
MOST_SUBMITTED = 512
"""Jobs that a cluster is given at once: each carries its plan, and their number has no bound."""


class Keyed(Protocol):
    """What can be told apart by a key of all that it depends on."""

    @property
    def key(self) -> str:
        """The key, as 16 hexadecimal digits."""
        ...


Job = TypeVar("Job", bound=Keyed)


def on_cluster(function: Callable[[Job], Done], jobs: Sequence[Job], address: str) -> Iterator[tuple[Job, Done]]:
    """Yield each job with what `function`, a module's own, returns of it, from the Dask cluster at `address`.

    Where the scheduler is lost, its jobs are given to the one that answers there next.

    Raises:
        InputError: distributed is not installed, nothing answers there, or the cluster has no workers.
        GoalMissed: a job's workers died again and again, or the scheduler did, or did not come back.
    """
    left = {job.key: job for job in jobs}
    for attempt in range(ATTEMPTS):
        with _client(address, again=attempt > 0) as client, suppress(CancelledError, OSError):
            for job, done in _submitted(function, list(left.values()), client):
                del left[job.key]
                yield job, done
            return
    raise GoalMissed(
        f"--scheduler {address}: the scheduler was lost {ATTEMPTS} times, with {len(left)} jobs undone; finished jobs "
        "are kept: see what ends it, and run the same command again"
    )


def _client(address: str, *, again: bool) -> "Client":
    """Return a client of the cluster; again: it answered before, and is given time to come back."""
    try:
        from distributed import Client
    except ImportError as error:
        raise InputError(
            f"--scheduler {address}: the package distributed is not installed; pip install 'dpcontrol[cluster]'"
        ) from error
    try:
        client = Client(address, timeout=BACK_WITHIN if again else ANSWERS_WITHIN)
        if again:
            client.wait_for_workers(1, timeout=BACK_WITHIN)
    except (OSError, TimeoutError, ValueError) as error:
        if again:
            raise GoalMissed(
                f"--scheduler {address}: the scheduler was lost, and did not come back with workers; finished jobs are "
                "kept: start it again, and run the same command again"
            ) from error
        raise InputError(
            f"--scheduler {address}: no Dask scheduler answers there; start one with `dask scheduler`"
        ) from error
    if not client.scheduler_info()["workers"]:
        client.close()
        raise InputError(f"--scheduler {address}: the cluster has no workers; start one with `dask worker {address}`")
    return client


def _submitted(function: Callable[[Job], Done], jobs: Sequence[Job], client: "Client") -> Iterator[tuple[Job, Done]]:
    """Yield jobs and what came of them as the cluster finishes them.

    Raises:
        CancelledError, OSError: the scheduler was lost.
        GoalMissed: a job's workers died again and again.
    """
    from distributed import KilledWorker, as_completed

    waiting = iter(jobs)

    def submitted(count: int) -> "dict[Future, Job]":
        return {
            client.submit(function, job, key=f"dpcontrol-{job.key}", retries=ATTEMPTS): job
            for job in islice(waiting, count)
        }

    running = submitted(MOST_SUBMITTED)
    finished = as_completed(running)
    for future in finished:
        try:
            done = future.result()
        except KilledWorker as error:
            raise GoalMissed(
                f"the cluster's workers died again and again on one job ({error}); finished jobs are kept"
            ) from error
        yield running.pop(future), done
        more = submitted(1)
        running |= more
        finished.update(more)
