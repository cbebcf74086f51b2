"""A job survives the end of an idle process that was meant to do it."""

import asyncio
import os
import signal

from dpcontrol.planner.workers import Workers


def test_a_job_is_given_to_another_process_if_the_idle_one_is_dead() -> None:
    async def reports() -> list[tuple[str, str]]:
        workers, heard = Workers(), []
        await workers.prepare()
        (process,) = workers._idle
        os.kill(process.pid, signal.SIGKILL)
        assert process.returncode is None
        await workers.run("page", {"log": "missing.mcap"}, lambda word, value: heard.append((word, value)))
        await workers.close()
        return heard

    ((word, value),) = asyncio.run(reports())
    assert word == "failed"
    assert "missing.mcap" in value
