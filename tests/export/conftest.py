"""Controllers exported once per session: of one itinerary, in double and in single precision."""

from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Any

import pytest

from dpcontrol.control import export
from dpcontrol.plans.itinerary import load_itinerary
from dpcontrol.plans.plan import make_plan
from dpcontrol.runs.run import export_plan


@pytest.fixture(scope="session")
def double(exported_law: Callable[..., Path]) -> Path:
    return exported_law("outer-turn", "adaptive", "double")


@pytest.fixture(scope="session")
def single(exported_law: Callable[..., Path]) -> Path:
    return exported_law("outer-turn", "adaptive", "single")


@pytest.fixture(scope="session")
def exported_law(tmp_path_factory: pytest.TempPathFactory) -> Callable[..., Path]:
    """Return the folder of an itinerary, a law and a precision, with further settings of [run]."""

    @cache
    def made(itinerary: str, law: str, precise: str, **run: Any) -> Path:
        folder = tmp_path_factory.mktemp(law) / "controller"
        with pytest.MonkeyPatch.context() as patch:
            patch.setattr(export, "_measured", lambda files: (None, None))
            scene = load_itinerary(itinerary).with_run({"controller": law, **run})
            export_plan(make_plan(scene), folder, single=precise == "single")
        return folder

    return made
