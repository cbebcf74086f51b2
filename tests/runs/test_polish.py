"""Plans re-optimised as one problem: what counts as the same walk, what is refused, what a polished plan is worth."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from command_line import dpcontrol

from dpcontrol import api
from dpcontrol.foundation.causes import DepartureCause
from dpcontrol.foundation.errors import InputError
from dpcontrol.judge.decoding import shortfall
from dpcontrol.plans.plan import Plan, load_plan
from dpcontrol.references.find import tail
from dpcontrol.references.reference import Reference, joined
from dpcontrol.runs.polish import SHARE, Departure, departure, nearness

STAYS = 1e-9  # rad and m: what is not re-optimised is copied
TOUR = 'model = "lab"\nstart = "rest"\nfinish = "rest"\n[[parts]]\nhold = "down-up"\nseconds = 1.5\n'
COARSE = '[reference]\nmethod = "radau-5"\ninterval = 0.1\ntolerance = 1e-4\n'


@pytest.fixture(scope="module")
def turns() -> Plan:
    return api.plan("double-turn")


def part(motion: Reference, begin: float, end: float) -> Reference:
    return tail(motion, begin, seconds=end - begin, turns=np.zeros(2))


def test_a_plan_keeps_its_own_walk(turns: Plan) -> None:
    assert departure(turns.reference, turns.reference) is None
    assert shortfall(turns.reference) is None


def test_turns_the_other_way_are_another_walk(turns: Plan) -> None:
    mirrored = turns.reference.states.copy()
    mirrored[..., :2] *= -1
    departed = departure(turns.reference, replace(turns.reference, states=mirrored))
    assert departed == Departure(DepartureCause.NO_CROSSING, symbol=turns.content.symbols[0].text)


def test_one_wobble_more_at_a_stop_is_another_walk(turns: Plan) -> None:
    motion, content = turns.reference, turns.content
    first, second = (symbol.time for symbol in content.symbols)
    period = content.orbit(content.stops[1]).period
    middle = (first + second) / 2
    longer, _ = joined([part(motion, 0.0, middle + period / 2), part(motion, middle - period / 2, motion.duration)])
    departed = departure(motion, longer)
    assert (departed.cause, departed.stop) == (DepartureCause.WRAPS, 1)


def test_an_arm_that_turns_once_more_between_two_symbols_is_another_walk(turns: Plan) -> None:
    motion = turns.reference
    first, second = (symbol.time for symbol in turns.content.symbols)
    times = motion.mesh[:-1, None] + np.diff(motion.mesh)[:, None] * motion.method.support
    states = motion.states.copy()
    inside = (times > first) & (times < second)
    states[..., 1] += np.where(inside, -2 * np.pi * np.sin(np.pi * (times - first) / (second - first)) ** 2, 0.0)
    assert departure(motion, replace(motion, states=states)) is not None


@pytest.mark.slow
def test_a_polished_plan_costs_less_keeps_its_holds_and_can_be_flown_from_its_file(tmp_path: Path) -> None:
    """Slow: plans two transfers and searches for both again."""
    scene, file = tmp_path / "tour.toml", tmp_path / "tour.npz"
    scene.write_text(TOUR + COARSE)
    ended = dpcontrol("plan", str(scene), "--polish", "--out", str(file), "--json")
    assert ended.code == 0, ended.stderr
    robust, polished = ended.document["polish"]["sides"]
    assert polished["effort"] <= robust["effort"] * (1 + 1e-6)
    assert polished["completed"]["0.05"]["rate"] >= 0.9
    plan, better = api.plan(str(scene)), load_plan(file)
    motion, content = better.reference, better.content
    assert motion.converged
    assert shortfall(motion) is None
    assert content.polished == pytest.approx(nearness(motion))
    assert abs(motion.duration - plan.reference.duration) < STAYS
    (_, begin), (end, last) = content.transfers
    for times in (np.linspace(begin, end, 50), np.linspace(motion.duration - 0.8, motion.duration, 50), [0.0]):
        assert np.abs(motion.state(times) - plan.reference.state(times)).max() < STAYS
    assert last < motion.duration
    for name, bound in plan.itinerary.limits.named().items():
        assert motion.largest[name] <= max(SHARE * bound, plan.reference.largest[name]) * (1 + 1e-6)
    run = api.run(better, mismatch=0.02, seed=1)
    assert run.converged, run.status
    with pytest.raises(InputError, match="is polished already"):
        api.polish(better)
