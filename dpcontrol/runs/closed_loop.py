"""The closed loop of a plan: what flies it, made once, for runs, campaigns, margins and export."""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path

from dpcontrol.control.export import ControllerSource
from dpcontrol.control.margins import Margins
from dpcontrol.foundation.arguments import place
from dpcontrol.foundation.progress import Reporting, reporting
from dpcontrol.foundation.rendering import live_view
from dpcontrol.judge.preflight import Preflight
from dpcontrol.loop.assembly import Assembly
from dpcontrol.loop.own import OwnObject
from dpcontrol.plans.plan import Plan, recoverable
from dpcontrol.plans.run_options import RunOptions
from dpcontrol.runs.campaign import Campaign, CampaignSettings, cases_of, run_campaign
from dpcontrol.runs.preflight import PreflightSettings, preflight
from dpcontrol.runs.run import Run, assembled, check_exportable, export_plan, run_plan


@dataclass(frozen=True, eq=False)
class ClosedLoop:
    """A plan with the options of its runs. Controller, fallback and recovery are made at the first run, once.

    Raises:
        InputError: an impossible option.
    """

    planned: Plan
    options: RunOptions = field(default_factory=RunOptions)

    def __post_init__(self) -> None:
        """Check the options."""
        _ = self.plan

    def __repr__(self) -> str:
        loop = self.plan.itinerary.loop
        return f"<closed loop {self.plan.itinerary.name!r}: {loop.controller.kind}, {loop.estimator.kind}>"

    @cached_property
    def plan(self) -> Plan:
        """The plan, its itinerary with the options in place."""
        return replace(self.planned, itinerary=self.planned.itinerary.with_run(self.options))

    @cached_property
    def assembly(self) -> Assembly:
        """What runs are made of.

        Raises:
            GoalMissed: there is no reference to follow.
        """
        return assembled(self.plan)

    @cached_property
    def _flown(self) -> tuple[Plan, Assembly]:
        """The plan with ways from rest where its runs need them, and what flies it."""
        plan = recoverable(self.plan.followed())
        return plan, replace(self.assembly, reference=plan.reference, law=self.assembly.controller)

    def run(
        self,
        *,
        seed: int = 0,
        rig: object = None,
        log: Path | str | None = None,
        force: bool = False,
        live: bool = False,
        progress: Reporting = None,
    ) -> Run:
        """Run once on the simulated bench, or on a rig.

        Args:
            seed: of all that is random.
            rig: an object with `read()`, `command(acceleration)` and `stop()`, in place of the simulated bench.
            log: file to write the run's log to; without one it stays in memory.
            force: replace the log of another run there.
            live: show the run in the viewer while it happens.
            progress: where progress goes; see `dpcontrol.api`.

        Raises:
            InputError: the rig lacks a method, the log cannot be written, or there is no display for a live view.
            GoalMissed: there is no reference to follow, no controller can be made for it, or the rig failed at once.
        """
        own = None if rig is None else OwnObject("rig", rig)
        plan, assembly = self._flown
        scene = replace(plan.itinerary, loop=replace(plan.itinerary.loop, seed=seed))
        with reporting(progress, "run") as report:
            return run_plan(
                replace(plan, itinerary=scene), place("log", log),
                assembly=assembly.under(scene.loop), rig=own, force=force, live=live_view if live else None,
                progress=report,
            )  # fmt: skip

    def campaign(
        self,
        *,
        runs: int = 100,
        over: Mapping[str, object] | None = None,
        settings: CampaignSettings | None = None,
        transitions: bool = False,
        out: Path | str | None = None,
        force: bool = False,
        yes: bool = False,
        progress: Reporting = None,
    ) -> Campaign:
        """Run many seeds, and count how often the itinerary is completed.

        Args:
            runs: seeds of each case.
            over: values of run options by name, or one value; each combination is a case.
            settings: first seed, workers and the like, in place of `runs`.
            transitions: run each transfer from hold to hold alone.
            out: Parquet file to write the rows to.
            force: replace the table of another campaign there.
            yes: run it however long it takes.
            progress: where progress goes; see `dpcontrol.api`.

        Raises:
            InputError: an unknown option or impossible value, or the file cannot be written.
            GoalMissed: there is no reference to follow, or workers died again and again.
        """
        cases = cases_of(self.planned.itinerary, fixed=self.options, over=over or {})
        with reporting(progress, "campaign") as report:
            return run_campaign(
                self.planned, cases, place("out", out), settings=settings or CampaignSettings(runs),
                transitions=transitions, force=force, yes=yes, progress=report,
            )  # fmt: skip

    def margins(self) -> Margins:
        """Return what gain, further delay and further lag the loop bears along the reference; takes some seconds.

        Raises:
            InputError: the law has no margins.
            GoalMissed: there is no reference to follow, or no controller can be made for it.
        """
        return self.assembly.margins()

    def preflight(self, *, runs: int = 0, workers: int = 0, yes: bool = False, progress: Reporting = None) -> Preflight:
        """Return how likely a run completes, what ends it otherwise, how far each border is, and what would help.

        Args:
            runs: seeds for the rate, 0 for as many as two minutes allow.
            workers: processes, 0 for one on each processor.
            yes: however long it takes.
            progress: where progress goes; see `dpcontrol.api`.

        Raises:
            InputError: it would take too long.
            GoalMissed: there is no reference to follow, or no controller can be made for it.
        """
        with reporting(progress, "preflight") as report:
            return preflight(
                self.planned, self.options, settings=PreflightSettings(runs=runs, workers=workers), yes=yes,
                progress=report,
            )  # fmt: skip

    def export(
        self,
        folder: Path | str | None = None,
        *,
        single: bool = False,
        force: bool = False,
        progress: Reporting = None,
    ) -> ControllerSource:
        """Return the controller as C99, and write it to a folder if one is given.

        Args:
            folder: to write to, whole or not at all.
            single: in single precision.
            force: replace files of the same names there.
            progress: where progress goes; see `dpcontrol.api`.

        Raises:
            InputError: the law or the estimator cannot leave as C, or the folder holds something else.
            GoalMissed: there is no reference to follow, or no controller can be made for it.
        """
        check_exportable(self.plan.itinerary)
        with reporting(progress, "export") as report:
            out = place("folder", folder)
            return export_plan(self.plan, out, assembly=self.assembly, single=single, force=force, progress=report)
