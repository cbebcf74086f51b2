"""Pool of worker processes, with one idle worker in reserve."""

import asyncio
import json
import os
import subprocess
import sys
from asyncio.subprocess import Process
from collections.abc import Callable
from contextlib import suppress
from typing import Any

OnReport = Callable[[str, str], None]
"""Callback with a word and its JSON, as in `dpcontrol.planner.worker`, or with `died` and the exit status."""
_LINE = 1 << 27
"""Largest length of a line, bytes, for an atlas with many connections."""
_AT_ONCE = 4
"""Number of simultaneous jobs, in addition to one search for bifurcations."""
_GENTLE = 15
"""Nice value of the search for bifurcations, which runs in the background."""


class WorkerJob:
    """One job with its arguments, progress and a function to restart it."""

    def __init__(
        self, do: str, given: dict[str, Any], on_report: OnReport, again: Callable[[], None] | None = None
    ) -> None:
        self.what, self.done, self.again = do, 0.0, again
        self._line = json.dumps({"do": do, **given}).encode() + b"\n"
        self._on_report = on_report

    def start(self, workers: "Workers", *, nice: int = 0) -> None:
        """Start the job in a process.

        Args:
            workers: pool with idle processes.
            nice: nice value of the process, which is then not reused.
        """
        self._task = asyncio.get_running_loop().create_task(self._follow(workers, nice))

    def kill(self) -> None:
        """Kill the job and suppress further reports."""
        self._task.cancel()

    async def _follow(self, workers: "Workers", nice: int) -> None:
        async with workers.gentle if nice else workers.slots:
            process: Any = await workers.taken()
            ended = False
            try:
                if nice and hasattr(os, "setpriority"):
                    os.setpriority(os.PRIO_PROCESS, process.pid, nice)
                with suppress(OSError):
                    process.stdin.write(self._line)
                    await process.stdin.drain()
                while not ended and (line := await process.stdout.readline()):
                    word, _, value = line.decode().rstrip("\n").partition(" ")
                    if word == "progress":
                        self.what, self.done = json.loads(value)
                    ended = word in ("done", "failed")
                    self._on_report(word, value)
                if not ended:
                    code = await process.wait()
                    self._on_report("died", f"signal {-code}" if code < 0 else f"exit code {code}")
            finally:
                workers.give_back(process) if ended and not nice else _end(process)


class Workers:
    """Pool of the processes that run the jobs of all pages.

    The callback `marked` receives a model and its bifurcations as JSON, once per model.
    """

    def __init__(self, marked: Callable[[str, str], None]) -> None:
        self._idle: list[Process] = []
        self._all: list[Process] = []
        self._marks: dict[str, WorkerJob] = {}
        self._marked = marked
        # The semaphores limit the jobs of many simultaneous pages.
        self.slots, self.gentle = asyncio.Semaphore(_AT_ONCE), asyncio.Semaphore(1)

    async def prepare(self) -> None:
        """Start an idle worker."""
        self.give_back(await self._started())

    async def taken(self) -> Process:
        """Return an idle or new worker."""
        idle = [process for process in self._idle if process.returncode is None]
        self._idle = idle[1:]
        return idle[0] if idle else await self._started()

    def give_back(self, process: Process) -> None:
        """Return a worker to the pool, which keeps two idle workers."""
        if len(self._idle) < 2:
            self._idle.append(process)
        else:
            _end(process)

    def mark(self, model: str) -> None:
        """Start the search for a model's bifurcations, once.

        Args:
            model: name or path of the model.
        """

        def on_report(word: str, value: str) -> None:
            if word == "done":
                self._marked(model, value)

        if model not in self._marks:
            self._marks[model] = WorkerJob("marks", {"model": model}, on_report)
            self._marks[model].start(self, nice=_GENTLE)

    async def close(self) -> None:
        """Kill all processes."""
        for process in self._all:
            _end(process)
            await process.wait()

    async def _started(self) -> Process:
        process = await asyncio.create_subprocess_exec(
            sys.executable, "-m", "dpcontrol.planner.worker",
            stdin=subprocess.PIPE, stdout=subprocess.PIPE, limit=_LINE, start_new_session=True,
        )  # fmt: skip
        self._all.append(process)
        return process


def _end(process: Process) -> None:
    with suppress(ProcessLookupError):
        process.kill()
