"""Controllers exported once per session: of one itinerary, in double and in single precision."""

from collections.abc import Callable
from functools import cache
from pathlib import Path

import pytest

from dpcontrol.control import export
from dpcontrol.control.export import ControllerSource
from dpcontrol.plans.itinerary import load_itinerary
from dpcontrol.plans.plan import Plan, make_plan
from dpcontrol.runs.run import export_plan


@pytest.fixture(scope="session")
def plan() -> Plan:
    return make_plan(load_itinerary("outer-turn"))


@pytest.fixture(scope="session")
def double(plan: Plan, tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, ControllerSource]:
    folder = tmp_path_factory.mktemp("double") / "controller"
    with pytest.MonkeyPatch.context() as patch:
        # One of the two is measured, by gcc, which takes a second or two.
        patch.setattr(export, "_measured", lambda files: (None, None))
        return folder, export_plan(plan, folder)


@pytest.fixture(scope="session")
def single(plan: Plan, tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, ControllerSource]:
    folder = tmp_path_factory.mktemp("single") / "controller"
    return folder, export_plan(plan, folder, single=True)


@pytest.fixture(scope="session")
def exported_law(tmp_path_factory: pytest.TempPathFactory) -> Callable[..., Path]:
    """Return the folder of an itinerary, a law and a precision, with the frequency of an elastic belt, Hz, if any."""

    @cache
    def made(itinerary: str, law: str, precise: str, belt: float = 0.0) -> Path:
        folder = tmp_path_factory.mktemp(law) / "controller"
        with pytest.MonkeyPatch.context() as patch:
            patch.setattr(export, "_measured", lambda files: (None, None))
            scene = load_itinerary(itinerary).with_run({"controller": law, "belt": belt})
            export_plan(make_plan(scene), folder, single=precise == "single")
        return folder

    return made


# The benchmarks run the same tests in single precision, after seconds of gcc. Otherwise only a whole itinerary
# and a Cortex-M4 are tested in single precision.
@pytest.fixture(scope="session", params=["double", pytest.param("single", marks=pytest.mark.benchmark)])
def exported(request: pytest.FixtureRequest) -> tuple[Path, ControllerSource]:
    return request.getfixturevalue(request.param)
