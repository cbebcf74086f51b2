"""Where a campaign's jobs run: processes of this machine, or a Dask cluster; finished jobs come back in any order.

A worker that dies takes its job along; the job is run again elsewhere. Local workers are made anew; Dask does that
itself.
"""

from collections.abc import Iterator, Sequence

from dpcontrol.foundation.errors import GoalMissed, InputError
from dpcontrol.foundation.processes import ATTEMPTS, in_processes
from dpcontrol.scenes.campaign_jobs import Job, Row, run_job

ANSWERS_WITHIN = "10s"
"""How long a cluster may take to answer."""


def run_locally(jobs: Sequence[Job], workers: int) -> Iterator[tuple[Job, list[Row]]]:
    """Run jobs in `workers` processes; where the caller is interrupted or takes no more, those under way are ended.

    Raises:
        InputError, GoalMissed: as `run_job`; the latter also when a job's worker died again and again.
    """
    return in_processes(
        run_job, jobs, workers,
        remedy="Finished jobs are kept: run the same command again, with fewer --workers",
    )  # fmt: skip


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
