"""Worker process for long jobs, which may be killed at any time.

`python -m dpcontrol.planner.worker` reads one job per line from standard input, as JSON {"do": NAME, ...}. It writes
lines that consist of a word and JSON: `progress [TEXT, SHARE]`, `show:KIND VALUE` for the page, and `remark TEXT`. The
last line of a job is `done VALUE`, or `failed {"status": SENTENCE, "fault": INDEX, "wraps": [COUNT, …]}` with the
failed symbol of a walk and the wraps that work. The process exits at the end of its input.
"""

import base64
import json
import os
import queue
import sys
import threading
import time
import warnings
from dataclasses import replace
from io import BytesIO
from pathlib import Path
from typing import Any

from dpcontrol.foundation.document import plain
from dpcontrol.foundation.errors import GoalMissed, InputError, PartMissing, Remark, printable
from dpcontrol.foundation.progress import part_of
from dpcontrol.judge.of_log import run_view
from dpcontrol.logs import read_log
from dpcontrol.pages.film import write_film
from dpcontrol.pages.viewer import check_viewer, view_in_window
from dpcontrol.planner.draft import read_draft
from dpcontrol.planner.shown import figures_of, fitting_model, shown_atlas, shown_plan, shown_run
from dpcontrol.plans.atlas import make_atlas
from dpcontrol.plans.plan import Plan, make_plan
from dpcontrol.runs.campaign import CampaignSettings, Case, run_campaign
from dpcontrol.runs.run import Run, run_plan

SEEDS = 20
"""Number of runs in the success count."""
_EVERY = 0.05
"""Interval between progress reports, s."""


class Jobs:
    """The jobs by name, whose reports are lines of one stream, `_file`.

    Reports of progress before the time `_next`, s of the monotonic clock, are dropped.
    """

    def __init__(self, handle: int) -> None:
        """Write reports to the open file descriptor `handle`, the process's original standard output."""
        self._file, self._next = os.fdopen(handle, "w", encoding="utf-8"), 0.0

    def write(self, word: str, value: Any) -> None:
        """Write one report: a line of a word and JSON.

        Args:
            word: kind of the report: "progress", "remark", "show:KIND" for the page, "done" or "failed".
            value: its value, which becomes JSON.
        """
        self._file.write(f"{word} {json.dumps(plain(value), ensure_ascii=False)}\n")
        self._file.flush()

    def progress(self, what: str, done: float) -> None:
        """Report a job's progress, at most 20 times a second.

        Args:
            what: label of the task.
            done: completed share, 0 to 1.
        """
        if (now := time.monotonic()) >= self._next:
            self._next = now + _EVERY
            self.write("progress", [what, min(max(float(done), 0.0), 1.0)])

    def do_atlas(self, *, model: str, energy: float) -> dict[str, Any]:
        """Show the atlas of a model at an energy, J.

        The result has the energy, the model, and the names and short symbols of the connections, which the page offers.
        """
        atlas = make_atlas(fitting_model(model), energy, progress=self.progress)
        shown = {**shown_atlas(atlas, fitting_model(model)), "model": model}
        self.write("show:atlas", shown)
        names = [connection["name"] for connection in shown["connections"]]
        return {"energy": energy, "model": model, "names": names, "symbols": shown["symbols"]}

    def do_plan(self, *, text: str) -> dict[str, Any]:
        """Plan the itinerary of a TOML text and show its motion; the result has the plan's figures."""
        plan = self._planned(text).followed()
        self.write("show:plan", shown_plan(plan))
        return {"converged": True, "status": plan.status, **figures_of(plan)}

    def do_run(self, *, text: str, seed: int, folder: str) -> dict[str, Any]:
        """Run the itinerary of a TOML text with a seed and show its motion; the log is written to a folder.

        The result is the run's document with a sentence and the log's path.
        """
        plan = self._planned(text, 0.1)
        plan = replace(plan, itinerary=plan.itinerary.with_run({}, seed=seed))
        log = Path(folder) / f"run-{seed}.mcap"
        run = run_plan(plan, log, force=True, progress=part_of(self.progress, 0.1, 1.0))
        self.write("show:run", shown_run(run.log))
        return {**run.document(), "sentence": run.status, "log": str(log)}

    def do_seeds(self, *, text: str) -> dict[str, Any]:
        """Run the itinerary of a TOML text with 20 seeds, show the seeds that complete it, and return their number."""
        plan = self._planned(text)
        cases, settings = [Case(plan.itinerary.name, (), plan.itinerary.loop)], CampaignSettings(SEEDS, workers=1)
        campaign = run_campaign(plan, cases, settings=settings, yes=True, progress=self.progress)
        self.write("show:seeds", [row["completed"] for row in campaign.rows])
        return {"completed": campaign.completed.successes, "runs": SEEDS}

    def do_page(self, *, log: str) -> None:
        """Show the page of the run in a log (its path) as a picture."""
        picture = BytesIO()
        Run(read_log(log)).plot().savefig(picture, format="png")
        self.write("show:page", f"data:image/png;base64,{base64.b64encode(picture.getvalue()).decode()}")

    def do_film(self, *, log: str, film: str) -> None:
        """Write the film of the run in a log to the path `film`."""
        write_film(run_view(read_log(log)), film, yes=True, progress=self.progress)

    def do_rerun(self, *, log: str) -> None:
        """Open the viewer with the run in a log (its path)."""
        check_viewer("press Page or Film, or save the log and review it on another computer")
        view_in_window(run_view(read_log(log)), Path(log).stem)

    def _planned(self, text: str, share: float = 1.0) -> Plan:
        """Return the plan of a TOML text, from the cache if possible, in the first `share` of the job's progress.

        Raises:
            InputError: the text has a mistake or no symbols.
        """
        # The page starts no job for a text with a mistake, but a model's file may have changed since.
        draft = read_draft(text)
        if draft.itinerary is None:
            raise InputError(draft.problem)
        return make_plan(draft.itinerary, progress=part_of(self.progress, 0.0, share))


def failure_of(error: Exception) -> dict[str, Any]:
    """Return the cause of a failed job: a sentence, and if known the failed symbol's index and the wraps that work.

    Args:
        error: exception that ended the job.
    """
    expected = isinstance(error, GoalMissed | InputError | PartMissing)
    status = printable(str(error)) if expected else f"internal error in dpcontrol, {type(error).__name__}: {error}"
    return {"status": status, "fault": getattr(error, "symbol", None), "wraps": getattr(error, "wraps", None)}


def main() -> None:
    """Run the jobs that standard input lists, one after the other, until the end of input."""
    jobs = Jobs(os.dup(1))
    # Output of libraries is redirected to standard error.
    os.dup2(2, 1)
    warnings.simplefilter("always", Remark)
    warnings.showwarning = lambda text, kind, *_: jobs.write("remark", str(text)) if kind is Remark else None
    lines: queue.SimpleQueue[str] = queue.SimpleQueue()
    threading.Thread(target=_listen, args=(lines,), daemon=True).start()
    while True:
        job = json.loads(lines.get())
        try:
            jobs.write("done", getattr(jobs, f"do_{job.pop('do')}")(**job))
        except Exception as error:  # noqa: BLE001 - the page shows it, and the process goes on
            jobs.write("failed", failure_of(error))


def _listen(lines: "queue.SimpleQueue[str]") -> None:
    """Put each line of standard input into the queue, and exit at the end of input even during a computation.

    The end of input means that the server has gone, so that nobody waits for the result.
    """
    for line in sys.stdin:
        lines.put(line)
    os._exit(0)


if __name__ == "__main__":
    main()
