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
import tempfile
import threading
import time
import warnings
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

from dpcontrol.foundation.document import plain
from dpcontrol.foundation.errors import GoalMissed, InputError, PartMissing, Remark, printable
from dpcontrol.foundation.progress import Progress, part_of
from dpcontrol.foundation.toml import parse_toml
from dpcontrol.judge.of_log import run_view
from dpcontrol.logs import read_log
from dpcontrol.pages.film import write_film
from dpcontrol.pages.layout import save_figure
from dpcontrol.pages.viewer import check_viewer, view_in_window
from dpcontrol.planner.shown import energies_of, figures_of, fitting_model, shown_atlas, shown_plan, shown_run
from dpcontrol.plans.atlas import make_atlas, make_branches
from dpcontrol.plans.itinerary import itinerary_from
from dpcontrol.plans.plan import Plan, make_plan
from dpcontrol.runs.campaign import CampaignSettings, Case, run_campaign
from dpcontrol.runs.run import Run, run_plan

SEEDS = 20
"""Number of runs in the success count."""
_EVERY = 0.05
"""Interval between progress reports, s."""
_NAME = "planned"
"""Name of every plan, because the file's name may be chosen later."""


class Reporter:
    """Writer of a job's progress and results, one line each."""

    def __init__(self, handle: int) -> None:
        self._file, self._next = os.fdopen(handle, "w", encoding="utf-8"), 0.0

    def write(self, word: str, value: Any) -> None:
        """Write one line.

        Args:
            word: kind of the report.
            value: its value, which becomes JSON.
        """
        self._file.write(f"{word} {json.dumps(plain(value), ensure_ascii=False)}\n")
        self._file.flush()

    def progress(self, what: str, done: float) -> None:
        """Report progress at a limited rate.

        Args:
            what: label of the task.
            done: completed share, 0 to 1.
        """
        if (now := time.monotonic()) >= self._next:
            self._next = now + _EVERY
            self.write("progress", [what, min(max(float(done), 0.0), 1.0)])


def _atlas(report: Reporter, *, model: str, energy: float) -> dict[str, Any]:
    atlas = make_atlas(fitting_model(model), energy, progress=report.progress)
    shown = {**shown_atlas(atlas, fitting_model(model)), "model": model}
    report.write("show:atlas", shown)
    names = [one["name"] for one in shown["connections"]]
    return {"energy": energy, "model": model, "names": names, "symbols": shown["symbols"]}


def _marks(report: Reporter, *, model: str) -> list[dict[str, Any]]:
    """Return the energies and descriptions of the connections' bifurcations."""
    loaded, found = fitting_model(model), []
    # Each connection has images of the opposite kind.
    for pair in [pair for pair in loaded.system.sections if pair == tuple(sorted(pair))]:
        found += [
            {
                "energy": mark.energy,
                "text": f"{' → '.join(pair)}: {mark.kind}, connections: {mark.count_below} → {mark.count_above}",
            }
            for mark in make_branches(loaded, *pair, progress=report.progress).marks
            if mark.kind != "section-artefact" and mark.energy < energies_of(loaded)[1]
        ]
    return found


def _plan(report: Reporter, *, text: str) -> dict[str, Any]:
    plan = _planned(text, report.progress).followed()
    report.write("show:plan", shown_plan(plan))
    return {"converged": True, "status": plan.status, **figures_of(plan)}


def _run(report: Reporter, *, text: str, seed: int, log: str) -> dict[str, Any]:
    plan = _planned(text, part_of(report.progress, 0.0, 0.1))
    plan = replace(plan, itinerary=plan.itinerary.with_run({}, seed=seed))
    run = run_plan(plan, Path(log), force=True, progress=part_of(report.progress, 0.1, 1.0))
    report.write("show:run", shown_run(run.log))
    return {**run.document(), "sentence": run.status, "log": log}


def _seeds(report: Reporter, *, text: str) -> dict[str, Any]:
    plan = _planned(text, report.progress)
    campaign = run_campaign(
        plan,
        [Case(_NAME, (), plan.itinerary.loop)],
        settings=CampaignSettings(SEEDS, workers=1),
        yes=True,
        progress=report.progress,
    )
    report.write("show:seeds", [row["completed"] for row in campaign.rows])
    return {"completed": campaign.completed.successes, "runs": SEEDS}


def _page(report: Reporter, *, log: str) -> None:
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "page.png"
        save_figure(Run(read_log(log)).plot(), file)
        report.write("show:page", f"data:image/png;base64,{base64.b64encode(file.read_bytes()).decode()}")


def _film(report: Reporter, *, log: str, film: str) -> None:
    write_film(run_view(read_log(log)), film, yes=True, progress=report.progress)


def _rerun(_: Reporter, *, log: str) -> None:
    check_viewer("press Page or Film, or save the log and review it on another computer")
    view_in_window(run_view(read_log(log)), Path(log).stem)


JOBS: dict[str, Callable[..., Any]] = {
    "atlas": _atlas, "marks": _marks, "plan": _plan, "run": _run, "seeds": _seeds, "page": _page, "film": _film,
    "rerun": _rerun,
}  # fmt: skip


def _planned(text: str, progress: Progress) -> Plan:
    model = fitting_model(str(parse_toml(text, f"{_NAME}.toml").get("model", "lab")))
    return make_plan(itinerary_from(text, _NAME, model), progress=progress)


def failure_of(error: Exception) -> dict[str, Any]:
    """Return the cause of a failed job: a sentence, the failed symbol's index and the wraps that work, or None.

    Args:
        error: exception that ended the job.
    """
    if not isinstance(error, GoalMissed | InputError | PartMissing):
        return {"status": f"internal error in dpcontrol, {type(error).__name__}: {error}", "fault": None, "wraps": None}
    symbol, wraps = getattr(error, "symbol", None), getattr(error, "wraps", None)
    return {"status": printable(str(error)), "fault": symbol, "wraps": wraps}


def main() -> None:
    """Run jobs until the end of input."""
    report = Reporter(os.dup(1))
    # Output of libraries is redirected to standard error.
    os.dup2(2, 1)
    warnings.simplefilter("always", Remark)
    warnings.showwarning = lambda text, kind, *_: report.write("remark", str(text)) if kind is Remark else None
    jobs: queue.SimpleQueue[str] = queue.SimpleQueue()
    threading.Thread(target=_listen, args=(jobs,), daemon=True).start()
    while True:
        given = json.loads(jobs.get())
        try:
            report.write("done", JOBS[given.pop("do")](report, **given))
        except Exception as error:  # noqa: BLE001 - the page shows it, and the process goes on
            report.write("failed", failure_of(error))


def _listen(jobs: "queue.SimpleQueue[str]") -> None:
    """Queue jobs; exit at the end of input even during a computation."""
    for line in sys.stdin:
        jobs.put(line)
    os._exit(0)


if __name__ == "__main__":
    main()
