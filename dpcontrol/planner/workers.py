"""Processes for the jobs of all pages, which can be killed at any time."""

import asyncio
import json
import subprocess
import sys
from asyncio.subprocess import Process
from collections.abc import Callable
from contextlib import suppress
from typing import Any

OnReport = Callable[[str, str], None]
"""Callback with a word and its JSON, as in `dpcontrol.planner.worker`, or with `died` and the exit status."""
_AT_ONCE = 4
"""Number of simultaneous jobs of all pages."""
_LINE = 1 << 27
"""Largest length of a line, bytes, for an atlas with many connections."""


class Workers:
    """Pool of processes, which have loaded the package before their first job.

    `_idle` are those that wait for a job, `_all` all that were ever started, so that `close` ends every one, and
    `_slots` limits the number of jobs at a time.
    """

    def __init__(self) -> None:
        """Create an empty pool; processes are started when they are needed."""
        self._idle: list[Process] = []
        self._all: list[Process] = []
        self._slots = asyncio.Semaphore(_AT_ONCE)

    async def prepare(self) -> None:
        """Start an idle process."""
        self._idle.append(await self._started())

    async def run(self, do: str, given: dict[str, Any], on_report: OnReport) -> None:
        """Run a job in an idle or new process, which is killed if this task is cancelled.

        Args:
            do: name of the job.
            given: its arguments.
            on_report: receiver of its reports.
        """
        async with self._slots:
            # The end of an idle process may be noticed only when it does not answer.
            while not await self._attempt(json.dumps({"do": do, **given}).encode() + b"\n", on_report):
                pass

    async def _attempt(self, job: bytes, on_report: OnReport) -> bool:
        """Give a job, one line of JSON, to an idle or new process and pass on its reports until the job is finished.

        The result is False if an idle process ended without an answer, so that the job must be given to another one.
        """
        self._idle = [process for process in self._idle if process.returncode is None]
        is_conclusive = not self._idle
        process: Any = self._idle.pop() if self._idle else await self._started()
        is_finished = False
        try:
            with suppress(OSError):
                process.stdin.write(job)
                await process.stdin.drain()
            while not is_finished and (line := await process.stdout.readline()):
                word, _, value = line.decode().rstrip("\n").partition(" ")
                is_conclusive, is_finished = True, word in ("done", "failed")
                on_report(word, value)
            if is_conclusive and not is_finished:
                code = await process.wait()
                on_report("died", f"signal {-code}" if code < 0 else f"exit code {code}")
        finally:
            self._idle.append(process) if is_finished else _end(process)
        return is_conclusive

    async def close(self) -> None:
        """Kill all processes."""
        for process in self._all:
            _end(process)
            await process.wait()

    async def _started(self) -> Process:
        """Start a process that waits for jobs, and return it."""
        process = await asyncio.create_subprocess_exec(
            *(sys.executable, "-m", "dpcontrol.planner.worker"),
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            limit=_LINE,
            start_new_session=True,
        )
        self._all.append(process)
        return process


def _end(process: Process) -> None:
    """Kill a process, unless it has ended already."""
    with suppress(ProcessLookupError):
        process.kill()
