"""What settings, models and laws refuse, each kind by the name of what is wrong."""

from collections.abc import Callable
from dataclasses import replace
from functools import partial

import numpy as np
import pytest
from bench_stand_in import model_of
from shadowing_stand_in import StandIn

from dpcontrol.control.estimator_settings import EkfSettings
from dpcontrol.control.lqr import HoldSettings, hold_controller
from dpcontrol.control.ogy import OgySettings
from dpcontrol.control.periodic import periodic_gains
from dpcontrol.control.tracking import (
    AdaptiveSettings,
    TvlqrSettings,
    adaptive_controller,
    terminal_cost,
    tracking_controller,
)
from dpcontrol.foundation.errors import GoalMissed, InputError
from dpcontrol.references.reference import Reference


@pytest.mark.parametrize(
    ("call", "said"),
    [
        (partial(AdaptiveSettings, angle=np.nan), "angle"),
        (partial(AdaptiveSettings, trust=2.0), "trust"),
        (partial(EkfSettings, rate_noise=0.0), "rate_noise"),
        (partial(EkfSettings, augment=("zero",)), "zeros"),
        (partial(OgySettings, sections=0), "sections"),
        (partial(TvlqrSettings, schedule="tim"), "schedule"),
        (partial(hold_controller, [0.3, np.pi, 0.0, 0.0], model_of(), HoldSettings(), seconds=1.0), "equilibrium"),
    ],
)
def test_what_has_no_meaning_is_refused_by_name(call: Callable[[], object], said: str) -> None:
    with pytest.raises(InputError, match=said):
        call()


def test_motions_that_no_input_reaches_have_no_gains() -> None:
    with pytest.raises(GoalMissed, match="grows by 2"):
        periodic_gains(np.diag([2.0, 0.5])[None], np.array([[0.0, 1.0]]), weights=np.ones(2), effort=1.0)
    with pytest.raises(GoalMissed, match="cannot be stabilised"):
        terminal_cost(np.diag([1.5, 0.5]), np.array([0.0, 1.0]), weights=np.eye(2), effort=1.0)


def test_a_law_needs_a_converged_reference_and_an_estimator_of_what_it_foresees(
    turn: tuple[StandIn, Reference],
) -> None:
    with pytest.raises(InputError, match="cannot be tracked"):
        tracking_controller(replace(turn[1], converged=False), model_of(), TvlqrSettings())
    with pytest.raises(InputError, match="parameters"):
        adaptive_controller(turn[1], model_of(), AdaptiveSettings(), estimator=EkfSettings(augment=("friction",)))
