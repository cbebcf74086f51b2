"""Workers: processes that do one job at a time. One more than are used waits, so that none is waited for."""

import asyncio
import json
import os
import subprocess
import sys
from asyncio.subprocess import Process
from collections.abc import Callable
from contextlib import suppress
from typing import Any

Heard = Callable[[str, str], None]
"""Called with a word and its JSON: see `dpcontrol.planner.worker`; `died` comes with how the process ended."""
_LINE = 1 << 27
"""Bytes of the longest line: an atlas with many connections."""
_AT_ONCE = 4
"""Jobs at once, beside one search for bifurcations."""
_GENTLE = 15
"""How much the search for bifurcations, which nobody waits for, yields to everything else."""


class WorkerJob:
    """One job: what it is doing, what it was given, how far it is, and what begins it again."""

    def __init__(self, do: str, given: dict[str, Any], heard: Heard, again: Callable[[], None] | None = None) -> None:
        self.what, self.given, self.done, self.again = do, given, 0.0, again
        self._line = json.dumps({"do": do, **given}).encode() + b"\n"
        self._heard, self._killed = heard, False
        self._process: Process | None = None

    def start(self, workers: "Workers", *, nice: int = 0) -> None:
        """Begin it in a process, which is ended afterwards if it was made to yield to others."""
        self._task = asyncio.get_running_loop().create_task(self._follow(workers, nice))

    def kill(self) -> None:
        """End it at once; nothing is heard of it any more."""
        self._killed = True
        if self._process is not None:
            _end(self._process)

    async def _follow(self, workers: "Workers", nice: int) -> None:
        async with workers.gentle if nice else workers.slots:
            if not self._killed:
                await self._followed(await workers.taken(), workers, nice)

    async def _followed(self, process: Process, workers: "Workers", nice: int) -> None:
        if self._killed:
            workers.give_back(process)
            return
        self._process = process
        assert process.stdin is not None
        assert process.stdout is not None
        if nice and hasattr(os, "setpriority"):
            os.setpriority(os.PRIO_PROCESS, process.pid, nice)
        with suppress(OSError):
            process.stdin.write(self._line)
            await process.stdin.drain()
        while (line := await process.stdout.readline()) and not self._killed:
            word, _, value = line.decode().rstrip("\n").partition(" ")
            if word == "progress":
                self.what, self.done = json.loads(value)
            if ended := word in ("done", "failed"):
                _end(process) if nice else workers.give_back(process)
            self._heard(word, value)
            if ended:
                return
        code = await process.wait()
        if not self._killed:
            self._heard("died", f"signal {-code}" if code < 0 else f"exit code {code}")


class Workers:
    """Hands out workers, and keeps those that are idle. marked: called with a model's bifurcations, once, as JSON."""

    def __init__(self, marked: Callable[[str, str], None]) -> None:
        self._idle: list[Process] = []
        self._all: list[Process] = []
        self._marks: dict[str, WorkerJob] = {}
        self._marked = marked
        # Many pages at once wait for each other.
        self.slots, self.gentle = asyncio.Semaphore(_AT_ONCE), asyncio.Semaphore(1)

    async def prepare(self) -> None:
        """Have a worker ready."""
        self.give_back(await self._started())

    async def taken(self) -> Process:
        """Return a worker that is idle."""
        idle = [process for process in self._idle if process.returncode is None]
        self._idle = idle[1:]
        return idle[0] if idle else await self._started()

    def give_back(self, process: Process) -> None:
        """Keep a worker that is idle; more than two of them are ended."""
        if len(self._idle) < 2:
            self._idle.append(process)
        else:
            _end(process)

    def mark(self, model: str) -> None:
        """Have the bifurcations of a model's connections sought, once."""

        def heard(word: str, value: str) -> None:
            if word == "done":
                self._marked(model, value)

        if model not in self._marks:
            self._marks[model] = WorkerJob("marks", {"model": model}, heard)
            self._marks[model].start(self, nice=_GENTLE)

    async def close(self) -> None:
        """End all processes."""
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
