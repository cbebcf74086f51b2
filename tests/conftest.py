"""Shared by several folders of tests: references that take seconds to find, found once per session; and where plans
are kept meanwhile.
"""

import os
import pickle

# As the command line does: threads of a BLAS only hinder one another, between workers most of all.
os.environ.setdefault("OMP_NUM_THREADS", "1")

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from shadowing_stand_in import LAB, StandIn, high_crossing, low_turn

from dpcontrol.dynamics.chain import Level, arm_chain_equations
from dpcontrol.dynamics.system import System
from dpcontrol.plans.itinerary import load_itinerary
from dpcontrol.plans.model import Model, load_model
from dpcontrol.plans.plan import Plan, make_plan
from dpcontrol.references.find import find_reference
from dpcontrol.references.problem import ReferenceProblem, ReferenceSettings
from dpcontrol.references.reference import Reference


@pytest.fixture(scope="session", autouse=True)
def plans_of_this_session_only(tmp_path_factory: pytest.TempPathFactory) -> Iterator[None]:
    """Keep plans in a folder of this session, so that no test passes by a plan that older code made.

    Workers of one session share it: an itinerary is planned once. `.ci/run` names one folder for its two sessions.
    """
    base = tmp_path_factory.getbasetemp()
    root = base.parent if "PYTEST_XDIST_WORKER" in os.environ else base
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("DPCONTROL_CACHE", os.environ.get("DPCONTROL_TESTS_CACHE", str(root / "dpcontrol-cache")))
        yield


@pytest.fixture(scope="session", autouse=True)
def one_processor_for_each_worker() -> Iterator[None]:
    """Let work that takes a process per processor stay in this process, if other workers take the other processors.

    New processes would import everything again, for several seconds each. Tests of processes give their number.
    """
    with pytest.MonkeyPatch.context() as patch:
        for module in PARALLEL if "PYTEST_XDIST_WORKER" in os.environ else ():
            patch.setattr(f"dpcontrol.{module}.processors", lambda: 1)
        yield


@pytest.fixture(scope="session", autouse=True)
def gains_of_a_motion_once() -> Iterator[None]:
    """Share the adaptive law's gains between loops that fly the same motion. They take a second of work each time.

    tests/control/test_adaptive.py computes its own.
    """
    from dpcontrol.loop import controllers

    made, make = dict[bytes, Any](), controllers.adaptive_controller

    def shared(reference: Reference, model: Any, settings: Any, *, estimator: Any) -> Any:
        motion = replace(reference, plan=None)
        key = pickle.dumps((motion, model.parameters, model.period, model.lag, settings, estimator))
        if key not in made:
            if len(made) == MOTIONS:
                made.pop(next(iter(made)))
            made[key] = make(reference, model, settings, estimator=estimator)
        return made[key]

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(controllers, "adaptive_controller", shared)
        yield


@pytest.fixture(scope="session", autouse=True)
def enclosures_once() -> Iterator[None]:
    """Share the enclosures of flights between proofs: several tests prove the same orbit with other claims."""
    try:
        import flint
    except ImportError:
        yield
        return
    from dpcontrol.proofs import charts
    from dpcontrol.proofs.flow import Field

    fields, flights = dict[Any, Any](), dict[Any, Any]()
    make, fly = Field.of, charts.fly

    def field(system: Any, parameters: Any) -> Any:
        key = (system.equations, tuple(parameters), flint.ctx.prec)
        if key not in fields:
            fields[key] = make(system, parameters)
        return fields[key]

    def exact(ball: Any) -> Any:
        return [tuple(map(str, end.man_exp())) for end in (ball.mid(), ball.rad())] if ball.is_finite() else str(ball)

    def flown(field: Any, start: Any, spread: Any, duration: Any, settings: Any) -> Any:
        balls = [exact(ball) for ball in (*start, *spread.entries())]
        key = (id(field), repr(balls), duration, settings, flint.ctx.prec)
        if key not in flights:
            flights[key] = fly(field, start, spread, duration, settings)
        thin, derivative, end, steps = flights[key]
        return [*thin], flint.arb_mat(derivative), [*end], [[*step] for step in steps]

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(Field, "of", field)
        patch.setattr(charts, "fly", flown)
        yield


MOTIONS = 20
"""Most motions whose gains are kept, of a few MB each."""
PARALLEL = ("plans.transfers", "runs.campaign", "runs.polish", "runs.preflight", "runs.remedies")
"""Modules that ask for the number of processors."""

PLATFORM_REASONS = (
    # Another system than Linux.
    "is POSIX's", "are POSIX's", "is Linux's", "names of macOS are UTF-8",
    # No wheel for this Python or processor: see [project.optional-dependencies].
    "mat-io writes MATLAB's",
    # The environment: recordings that are not published, processors in use by others.
    "the rig's recordings are not in", "too busy for real time",
)  # fmt: skip
"""Parts of the reasons for which `.ci/run` lets a test be skipped: the test cannot run there whatever is installed."""


def _without_skip(report: Any) -> Any:
    """Return a report of a test or module. With DPCONTROL_TESTS_STRICT_SKIPS, a skip for want of a program fails."""
    if os.environ.get("DPCONTROL_TESTS_STRICT_SKIPS") and report.skipped and not hasattr(report, "wasxfail"):
        reason = str(report.longrepr[-1])
        if not any(part in reason for part in PLATFORM_REASONS):
            report.outcome = "failed"
            report.longrepr = f"{reason}\nInstall what it needs, or add the reason to PLATFORM_REASONS."
    return report


@pytest.hookimpl(wrapper=True)
def pytest_runtest_makereport() -> Iterator[Any]:
    """Check the reasons of skipped tests."""
    return _without_skip((yield))


@pytest.hookimpl(wrapper=True)
def pytest_make_collect_report() -> Iterator[Any]:
    """Check the reasons of skipped modules."""
    return _without_skip((yield))


LONGEST = (
    "test_proved_connections", "test_readme", "test_true_verdicts", "test_compilers_and_targets", "test_planner_page",
    "test_api_examples", "test_commissioning", "test_legibility", "test_examples",
    "test_notebooks", "test_without_heyoka", "test_types", "test_objects", "test_rig_verbs", "test_bifurcations",
    "test_chart_accuracy", "test_generated_scenes", "test_numbers_of_arms", "test_exported_controller",
    "test_batch", "test_fuzz", "test_run_verb", "test_own_systems", "test_figures", "test_extended", "test_walk_verb",
    "test_campaign", "test_kept_walks", "test_atlas", "test_demo_and_review_verbs", "test_help_and_streams",
    "test_identification", "test_hostile_packets", "test_two_turns", "test_named_symbols", "test_honest_searches",
    "test_replay", "test_api", "test_udp_program", "test_log_verbs", "test_itineraries",
)  # fmt: skip
"""Modules that take longest, slow tests or others: begun first, so that all workers end together."""


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Begin with the `LONGEST` modules."""
    places = {name: place for place, name in enumerate(LONGEST)}
    items.sort(key=lambda item: places.get(item.path.stem, len(places)))


@pytest.hookimpl(optionalhook=True)
def pytest_xdist_make_scheduler(config: pytest.Config, log: Any) -> Any:
    """Keep a module's tests on one worker, which makes the module's fixtures once; the README's sections share none.

    All proofs are made on one worker, since they enclose the same flights.

    A scheduler of our own, because pytest 9.2 does away with what `--dist loadgroup` of xdist 3.8 renames tests by. It
    would begin with the modules of most tests, which take least; those of `LONGEST` are in front already.
    """
    from xdist.scheduler import LoadScopeScheduling

    config.option.loadscopereorder = False

    class ModulesTogether(LoadScopeScheduling):
        def _split_scope(self, nodeid: str) -> str:
            module = nodeid.split("::", 1)[0]
            if "/proofs/" in module or "guide-proofs-" in nodeid:
                return "proofs"
            return nodeid if module.endswith("test_readme.py") else module

    return ModulesTogether(config, log)


def _tracked(orbit: StandIn) -> tuple[StandIn, Reference]:
    equations = arm_chain_equations(2, Level.CART)
    problem = ReferenceProblem(equations, LAB.base(), orbit.guess, orbit.duration)
    return orbit, find_reference(problem, ReferenceSettings())


@pytest.fixture(scope="session")
def lab() -> Model:
    """The lab's pendulum."""
    return load_model("lab")


@pytest.fixture(scope="session")
def system(lab: Model) -> System:
    """The lab's pendulum without friction."""
    return lab.system


@pytest.fixture(scope="session")
def plan() -> Plan:
    """The plan of the outer arm's turn that is shipped."""
    return make_plan(load_itinerary("outer-turn"))


@pytest.fixture(scope="session")
def turn() -> tuple[StandIn, Reference]:
    """The outer arm's turn at -0.07 J, and its reference."""
    return _tracked(low_turn())


@pytest.fixture(scope="session")
def reference(turn: tuple[StandIn, Reference]) -> Reference:
    """The reference of the turn."""
    return turn[1]


@pytest.fixture(scope="session")
def crossing() -> tuple[StandIn, Reference]:
    """From Down-Up to Up-Down at 0.2 J, and its reference."""
    return _tracked(high_crossing())


@pytest.fixture(params=["turn", "crossing"])
def tracked(request: pytest.FixtureRequest) -> tuple[StandIn, Reference]:
    """Each of the two in turn."""
    return request.getfixturevalue(request.param)


@pytest.fixture(scope="session")
def example(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Any]:
    """The variables of the README's example, with the log of its run."""
    values: dict[str, Any] = {}
    readme = (Path(__file__).parent.parent / "README.md").read_text(encoding="utf-8")
    exec(readme.partition("```python\n")[2].partition("```")[0], values)
    values["log"] = tmp_path_factory.mktemp("api") / "turn.mcap"
    values["logged"] = values["dp"].run(values["reference"], mismatch=0.02, seed=3, log=values["log"])
    return values
