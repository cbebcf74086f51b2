"""The closed loop of a plan, with components built once and shared by runs, campaigns, margins and export."""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import Any

from dpcontrol.control.export import ControllerSource
from dpcontrol.control.margins import Margins
from dpcontrol.foundation.arrays import Array
from dpcontrol.foundation.checked import Count, Index, Positive, Seed, Workers, checked
from dpcontrol.foundation.errors import InputError
from dpcontrol.foundation.progress import Reporting
from dpcontrol.foundation.rendering import live_view
from dpcontrol.foundation.shown import Timed
from dpcontrol.judge.night import Night
from dpcontrol.judge.preflight import Preflight
from dpcontrol.loop.assembly import Assembly
from dpcontrol.loop.own import OwnObject, names_file, own_object
from dpcontrol.loop.protocols import UserRig
from dpcontrol.plans.plan import Plan
from dpcontrol.runs.campaign import (
    STANDARD_CAMPAIGN,
    Campaign,
    CampaignSettings,
    asked_cases,
    run_campaign,
    standard_scores,
)
from dpcontrol.runs.night import (
    NightSettings,
    night_itinerary,
    run_night,
)
from dpcontrol.runs.preflight import PreflightSettings, preflight
from dpcontrol.runs.run import (
    OWN_BENCH,
    RigLink,
    Run,
    assembled,
    check_exportable,
    default_log,
    export_plan,
    rig_link,
    run_plan,
    run_with_program,
)


@dataclass(frozen=True, eq=False)
class ClosedLoop(Timed):
    """A plan with the options of its runs.

    Controller, fallback and recovery are built once, at the first run.

    Raises:
        InputError: an impossible option.

    Attributes:
        planned: plan that the loop follows.
        options: options of its runs, by name.
    """

    planned: Plan
    options: Mapping[str, Any] = field(default_factory=dict)

    def __post_init__(self) -> None:
        """Check the options."""
        _ = self.plan

    def __repr__(self) -> str:
        loop = self.plan.itinerary.loop
        return f"<closed loop {self.plan.itinerary.name!r}: {loop.controller.kind}, {loop.estimator.kind}>"

    @property
    def time_range(self) -> tuple[float, float]:
        """First and last time of the plan, s."""
        return self.plan.time_range

    @property
    def columns(self) -> tuple[str, ...]:
        """Names of the N entries of a state."""
        return self.plan.columns

    def states(self, times: Any = None) -> Array:
        """Return the planned states at given times; see `Plan.states`.

        Args:
            times: times (K,), s (default: 200 over the whole plan).
        """
        return self.plan.states(times)

    def document(self) -> dict[str, Any]:
        """Return the plan and the options as JSON values."""
        options = {
            name: value if isinstance(value, int | float) else str(value) for name, value in self.options.items()
        }
        return {"plan": self.plan.document(), "options": options}

    @cached_property
    def plan(self) -> Plan:
        """The plan, its itinerary with the options in place."""
        itinerary = self.planned.itinerary.with_run(self.options)
        itinerary.check_parts(self.planned.itinerary)
        return replace(self.planned, itinerary=itinerary)

    @cached_property
    def assembly(self) -> Assembly:
        """Components of the runs.

        Raises:
            GoalMissed: there is no reference to follow.
        """
        return assembled(self.plan)

    @checked
    def run(
        self,
        *,
        seed: Seed = 0,
        rig: UserRig | OwnObject | RigLink | str | None = None,
        program: Path | str | None = None,
        log: Path | str | None = None,
        force: bool = False,
        live: bool = False,
        progress: Reporting = None,
    ) -> Run:
        """Run once on the simulated bench, or on a rig.

        Args:
            seed: seed of the random numbers.
            rig: object with `read()`, `command(acceleration)` and `stop()`, or the address of a bench in real time:
                "udp", udp://HOST:PORT, serial://PORT, FILE.py:CLASS, or a link of `dp.rig_link` (default: the simulated
                bench).
            program: controlling program for rig "udp", such as main_udp of `export`.
            log: log to write (default: in memory, or logs/NAME-SEED.mcap in real time).
            force: replace the log of another run there.
            live: show the run in the viewer.
            progress: receiver of progress reports (see `dpcontrol.api`).

        Raises:
            InputError: the rig lacks a method or does not answer, the log cannot be written, or there is no display
                for a live view.
            GoalMissed: there is no reference to follow, no controller can be made for it, or the rig failed at once.
        """
        bench, plan, assembly = bench_of(rig), self.plan.followed(), self.assembly
        itinerary = replace(plan.itinerary, loop=replace(plan.itinerary.loop, seed=seed))
        plan, out = replace(plan, itinerary=itinerary), _path(log)
        if isinstance(bench, RigLink):
            out = out or default_log(itinerary)
        if program is not None:
            if not isinstance(bench, RigLink) or out is None or bench.address != OWN_BENCH:
                raise InputError('program: controls the example bench; give rig="udp" as well')
            return run_with_program(plan, out, Path(program), real_time=bench.real_time, force=force)
        return run_plan(
            plan,
            out,
            assembly=assembly.under(itinerary.loop),
            bench=bench,
            force=force,
            live=live_view if live else None,
            progress=progress,
        )

    @checked
    def night(
        self,
        hours: Positive | NightSettings,
        folder: Path | str,
        *,
        seed: Seed = 0,
        rig: OwnObject | RigLink | str | None = None,
        resume: bool = False,
        force: bool = False,
        live: bool = False,
        yes: bool = False,
        learn: bool = False,
        progress: Reporting = None,
    ) -> Night:
        """Repeat the itinerary for hours, through falls.

        Args:
            hours: duration, h, or settings with the length and number of logs.
            folder: folder for the logs.
            seed: seed of the random numbers.
            rig: "udp", udp://HOST:PORT, serial://PORT or a link of `dp.rig_link` (default: the simulated bench).
            resume: continue the interrupted night of this folder.
            force: replace another night there.
            live: show the run in the viewer.
            yes: accept any duration.
            learn: learn the arms from the first repetition, and follow a new plan from then on.
            progress: receiver of progress reports (see `dpcontrol.api`).

        Raises:
            InputError: the folder is not usable, no bench answers, or it would take too long.
            GoalMissed: there is no reference to follow, or no controller can be made for it.
        """
        night = hours if isinstance(hours, NightSettings) else NightSettings(hours)
        out, link = Path(folder), bench_of(rig)
        if isinstance(link, OwnObject):
            raise InputError(
                f'rig = {link}: a night needs a bench at an address; give "udp", udp://HOST:PORT or serial://PORT'
            )
        itinerary = night_itinerary(self.plan.itinerary.with_run({}, seed=seed), overrides=self.options)
        return run_night(
            replace(self.plan, itinerary=itinerary), out, night, link=link, resume=resume,
            force=force, live=live_view if live else None, yes=yes, learn=learn, progress=progress,
        )  # fmt: skip

    @checked
    def campaign(
        self,
        *,
        runs: Count = 100,
        over: Mapping[str, object] | None = None,
        settings: CampaignSettings | None = None,
        standard: bool = False,
        transitions: bool = False,
        out: Path | str | None = None,
        force: bool = False,
        yes: bool = False,
        progress: Reporting = None,
    ) -> Campaign:
        """Run many seeds and measure the success rate.

        Args:
            runs: seeds of each case.
            over: values of run options by name, each combination a case.
            settings: seeds, workers and other settings, replacing `runs`.
            standard: robustness score: nine kinds of disturbances at 21 levels each, of the controllers in `over`.
            transitions: run each transfer from hold to hold separately.
            out: Parquet file to write.
            force: replace the table of another campaign there.
            yes: accept any duration.
            progress: receiver of progress reports (see `dpcontrol.api`).

        Raises:
            InputError: an unknown option or impossible value, or the file cannot be written.
            GoalMissed: there is no reference to follow, or a process died.
        """
        itinerary, campaign_settings = (
            self.planned.itinerary,
            settings or (STANDARD_CAMPAIGN if standard else CampaignSettings(runs)),
        )
        cases = asked_cases(itinerary, fixed=self.options, over=over or {}, standard=standard, transitions=transitions)
        result = run_campaign(
            self.planned, cases, _path(out), settings=campaign_settings,
            transitions=transitions, force=force, yes=yes, progress=progress,
        )  # fmt: skip
        return replace(result, standard=standard_scores(result.results)) if standard else result

    def margins(self) -> Margins:
        """Return the margins of gain, delay and lag along the reference, after a few seconds of simulation.

        Raises:
            InputError: the law has no margins.
            GoalMissed: there is no reference to follow, or no controller can be made for it.
        """
        return self.assembly.margins()

    @checked
    def preflight(
        self,
        *,
        runs: Index = 0,
        first_seed: Seed = PreflightSettings.first_seed,
        workers: Workers = 0,
        yes: bool = False,
        progress: Reporting = None,
    ) -> Preflight:
        """Predict success rate, causes of failure, borders and useful changes.

        Args:
            runs: seeds for the rate, 0 for as many as two minutes allow.
            first_seed: first seed.
            workers: processes, 0 for one per processor.
            yes: accept any duration.
            progress: receiver of progress reports (see `dpcontrol.api`).

        Raises:
            InputError: it would take too long.
            GoalMissed: there is no reference to follow, or no controller can be made for it.
        """
        settings = PreflightSettings(runs=runs, first_seed=first_seed, workers=workers)
        return preflight(self.planned, self.options, settings=settings, yes=yes, progress=progress)

    @checked
    def export(
        self,
        folder: Path | str | None = None,
        *,
        single: bool = False,
        clock: Positive | None = None,
        force: bool = False,
        progress: Reporting = None,
    ) -> ControllerSource:
        """Return the controller as C99, and write it to the folder or unit if one is given.

        Args:
            folder: folder to write, or NAME.fmu for a co-simulation unit (FMI 2.0).
            single: use single precision.
            clock: clock of a Cortex-M4 that must keep the rate, MHz (default: not checked).
            force: replace files of the same names there.
            progress: receiver of progress reports (see `dpcontrol.api`).

        Raises:
            InputError: the law or the estimator cannot be exported to C, the target cannot keep the rate, or the folder
                holds something else.
            GoalMissed: there is no reference to follow, or no controller can be made for it.
        """
        check_exportable(self.plan.itinerary)
        return export_plan(self.plan, _path(folder), single=single, clock=clock, force=force, progress=progress)


def bench_of(rig: object) -> RigLink | OwnObject | None:
    """Return the link to a bench in real time, a user's rig, or None for the simulated bench.

    Args:
        rig: a user's object, FILE.py:CLASS, an address or a link.

    Raises:
        InputError: the address is malformed, the file cannot be loaded, or the rig lacks a method.
    """
    if isinstance(rig, str) and not names_file(rig):
        return rig_link(rig)
    return rig if rig is None or isinstance(rig, RigLink | OwnObject) else own_object("rig", rig)


def _path(file: Path | str | None) -> Path | None:
    """Return a file name as a path, or None without one."""
    return None if file is None else Path(file)
