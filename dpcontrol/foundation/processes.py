"""Parallel work in processes of this machine.

Results arrive in any order. If a process dies, the work ends; its callers keep finished results. If the parent process
dies, its workers end.
"""

import multiprocessing
import multiprocessing.connection
import os
import signal
import threading
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from typing import TypeVar

from dpcontrol.foundation.errors import GoalMissed
from dpcontrol.foundation.progress import Progress, no_progress

Piece = TypeVar("Piece")
Done = TypeVar("Done")


def processors() -> int:
    """Return the number of processors available to this process."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def in_processes(
    function: Callable[[Piece], Done],
    pieces: Sequence[Piece],
    workers: int,
    *,
    what: str = "pieces",
    progress: Progress = no_progress,
) -> Iterator[tuple[Piece, Done]]:
    """Yield each piece with its result, computed by `workers` processes.

    With one worker or one piece, everything runs in this process. If the caller is interrupted or stops iterating,
    running processes are ended.

    Args:
        function: function of a module, which computes the result of a piece.
        pieces: arguments of the function.
        workers: number of processes.
        what: name of the pieces in reports of progress.
        progress: receiver of a report after each result, with the label "K of N `what`".

    Raises:
        GoalMissed: a process died.
    """
    for k, result in enumerate(_results(function, pieces, workers), 1):
        yield result
        progress(f"{k} of {len(pieces)} {what}", k / len(pieces))


def _results(function: Callable[[Piece], Done], pieces: Sequence[Piece], workers: int) -> Iterator[tuple[Piece, Done]]:
    """Yield each piece with its result, in the order in which results arrive.

    If the caller stops early, or an error occurs, the processes that were started since the beginning of this call are
    ended.

    Args:
        function: function of a module, which computes the result of a piece.
        pieces: arguments of the function.
        workers: number of processes; with 1, or with one piece, everything runs in this one.

    Raises:
        GoalMissed: a process died.
    """
    if workers == 1 or len(pieces) <= 1:
        for piece in pieces:
            yield piece, function(piece)
        return
    other_children = set(multiprocessing.active_children())
    # Forked processes would share the threads of heyoka and casadi in an unknown state.
    context = multiprocessing.get_context("spawn")
    pool = ProcessPoolExecutor(workers, mp_context=context, initializer=end_with_parent)
    try:
        with ignoring_interrupts():
            pieces_of_futures = {pool.submit(function, piece): piece for piece in pieces}
        for future in as_completed(pieces_of_futures):
            yield pieces_of_futures[future], future.result()
        # At the end of a program, Python may use the pipes of processes that are still ending.
        pool.shutdown()
    except BrokenProcessPool as error:
        raise GoalMissed(
            "a process died: is there enough memory? A script must call this below "
            '`if __name__ == "__main__":`, or with workers=1. Finished results are kept: run the same command '
            "again, with fewer --workers"
        ) from error
    except BaseException:
        for worker in set(multiprocessing.active_children()) - other_children:
            worker.terminate()
        raise
    finally:
        pool.shutdown(wait=False, cancel_futures=True)


def end_with_parent() -> None:
    """End this process as soon as the parent that started it by `multiprocessing` has ended.

    A thread waits for the parent, since compiled code does not block threads. The kernel's death signal exists only on
    Linux and is sent when the parent's thread ends.
    """
    parent = multiprocessing.parent_process()
    if parent is not None:
        threading.Thread(target=_exit_after, args=(parent.sentinel,), daemon=True).start()


def _exit_after(sentinel: int) -> None:
    """End this process when the parent has ended, for which the system marks `sentinel` as ready."""
    multiprocessing.connection.wait([sentinel])
    os._exit(1)


@contextmanager
def ignoring_interrupts() -> Iterator[None]:
    """Ignore Ctrl-C in the block, as processes started in it do from then on; only the main thread can do so."""
    in_main = threading.current_thread() is threading.main_thread()
    previous_handler = signal.signal(signal.SIGINT, signal.SIG_IGN) if in_main else None
    try:
        yield
    finally:
        if in_main:
            signal.signal(signal.SIGINT, previous_handler)
