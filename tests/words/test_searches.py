"""Each cause of a search has a sentence, and no verdict depends on the sentences."""

from enum import StrEnum
from types import SimpleNamespace
from typing import Any

import pytest

from dpcontrol.foundation import causes
from dpcontrol.foundation.causes import (
    BranchCause,
    CutCause,
    FamilyEndCause,
    GapCause,
    GridCause,
    ObstacleCause,
    OrbitCause,
    ReferenceCause,
    RefinementCause,
    ShootingCause,
    WalkCause,
    WrapsCause,
)
from dpcontrol.foundation.errors import GoalMissed
from dpcontrol.planner.worker import failure_of
from dpcontrol.plans.itinerary import itinerary_from
from dpcontrol.plans.model import load_model
from dpcontrol.plans.planning import shadowing_orbit
from dpcontrol.references.ending import Obstacle
from dpcontrol.words import findings, searches

TURN_BORN = -0.141987140339  # J; saddle-node of turns, where one wrap is needed between two of them
OTHERS = {StrEnum, causes.Cause, causes.Fault, causes.FindingCause}  # The tables of runs and findings have these.
KINDS = [kind for kind in vars(causes).values() if isinstance(kind, type) and issubclass(kind, StrEnum)]
KINDS = [kind for kind in KINDS if kind not in OTHERS]
JOULE, OWN_UNITS = SimpleNamespace(unit=" {}".format), SimpleNamespace(unit=lambda name: "")
JOULES = SimpleNamespace(quantity="energy", unit=" J")
SHOT = {"residual": 1e-3, "iterations": 30}
WALK = {"walk": ("a", "b", "c"), "fault": 1, "wraps": (3,), "wraps_realised": (2,), "rival": "d"}
CUT = {"chord": 0.05, "trajectories": 100, "hit": 1, "section": SimpleNamespace(name="θ₂ = 0"), "longest": 12.0}
CUT |= {"open_ends": (), "unresolved": (), "spent": False, "seconds": 1.0}
GRID = {"connections": (), "searched": (-1.0, -0.9), "failed": 0, "left": 0, "partial": False, "seconds": 60.0}


def told(cause: StrEnum, **numbers: Any) -> str:
    """Return the sentence of a result with a cause and numbers."""
    return searches.SENTENCES[type(cause)][cause](SimpleNamespace(cause=cause, **numbers))


@pytest.mark.parametrize("cause", FamilyEndCause)
def test_ends_of_families_have_the_units_of_their_system(cause: FamilyEndCause) -> None:
    numbers = {"equilibrium": "L1", "multiplier": 1.0} | dict.fromkeys(
        ("energy", "height", "distance", "period", "limit", "residual"), 2.0
    )
    assert not set(told(cause, system=OWN_UNITS, **numbers).split()) & {"J", "J:", "J)", "s", "s,"}
    assert "2 J" in told(cause, system=JOULE, **numbers)


@pytest.mark.parametrize("kind", KINDS)
def test_each_cause_has_a_sentence(kind: type[StrEnum]) -> None:
    assert set(searches.SENTENCES[kind]) == set(kind)


def test_each_cause_of_a_finding_has_a_sentence() -> None:
    assert {cause for _, cause in findings.FINDINGS} == set(causes.FindingCause)


@pytest.mark.parametrize(
    ("cause", "numbers", "parts"),
    [
        (ShootingCause.CONVERGED, SHOT, ["converged in 30 iterations to a gap of 1.0e-03"]),
        (ShootingCause.ROUNDING, SHOT, ["not converged: gap 1.0e-03", "use more nodes"]),
        (RefinementCause.STALLED, SHOT, ["not refined", "1.0e-03", "use double precision"]),
        (WalkCause.SHOOTING, WALK | {"orbit": SimpleNamespace(status="no")}, ["symbol 2 of 3 (b): no"]),
        (WalkCause.RIVAL, WALK, ["symbol 2 of 3", "follows d instead of b", "more wraps"]),
        (WalkCause.OTHER_WRAPS, WALK, ["symbol 2 of 3", "wraps [2] instead of [3]"]),
        (WrapsCause.TOO_FEW, {"wraps": (1,), "tried": (0,)}, ["wraps [0] are too few: must be at least [1]"]),
        (
            WrapsCause.NONE_SUFFICE,
            {"most": 12, "failed": SimpleNamespace(status="no")},
            ["no wraps up to 12 suffice: no"],
        ),
        (
            OrbitCause.LOST,
            {"outcome": SimpleNamespace(reached=0.5, newton_residual=1e-3), "system": JOULE},
            ["only to 0.5 J", "nearer to the saddle's"],
        ),
        (CutCause.RESOLVED, CUT, ["resolved to chords of 0.05 by 100 trajectories"]),
        (CutCause.NEVER_ARRIVES, CUT, ["no trajectory", "crossing 1 of θ₂ = 0 within 12 periods"]),
        (CutCause.ESCAPES, CUT | {"spent": True}, ["no trajectory returns", "partial", "1 s of processor time"]),
        (
            BranchCause.SCATTERS,
            {
                "sampler": SimpleNamespace(
                    branch=1, hit=1, settings=SimpleNamespace(most_jumps=40, fine_phase_step=1e-4)
                )
            },
            ["branch +1 scatters before crossing 1", "--longest"],
        ),
        (
            GapCause.TOUCH,
            {"counts": (1, 2), "values": (0.1, 0.2), "course": JOULES},
            ["crossings change from 1 to 2 between energy = 0.1 J and 0.2 J"],
        ),
        (
            GapCause.UNFOLLOWED,
            {"duration": 2.5, "values": (0.1,), "course": SimpleNamespace(quantity="m2", unit="", system=OWN_UNITS)},
            ["a flight of 2.5 could not be followed beyond m2 = 0.1"],
        ),
        (ReferenceCause.SOLVER, {"answer": "no", "obstacle": Obstacle(ObstacleCause.FRICTION, share=0.5)}, ["50%"]),
        (GridCause.TIME, GRID | {"beyond": SimpleNamespace(energy=-0.95)}, ["at least 0 between", "before -0.95 J"]),
    ],
    ids=lambda value: value.name if isinstance(value, StrEnum) else "",
)
def test_a_sentence_has_its_numbers_and_a_remedy(cause: StrEnum, numbers: dict[str, Any], parts: list[str]) -> None:
    sentence = told(cause, **numbers)
    assert [part for part in parts if part not in sentence] == [], sentence


def test_the_planner_finds_the_symbol_and_the_wraps_whatever_the_sentences_are(monkeypatch: pytest.MonkeyPatch) -> None:
    energy = TURN_BORN + 2e-10
    text = f'model = "lab"\nenergy = {energy!r}\nwalk = ["down-up +", "down-up +"]\nwraps = [0]\n'
    itinerary = itinerary_from(text, "failing", load_model("lab"))

    def failure() -> dict[str, Any]:
        with pytest.raises(GoalMissed) as missed:
            shadowing_orbit(itinerary, itinerary.walks[0])
        return failure_of(missed.value)

    before = failure()
    assert (before["fault"], before["wraps"]) == (0, (1,))
    silent = {kind: dict.fromkeys(kind, lambda _: "…") for kind in KINDS}
    monkeypatch.setattr(searches, "SENTENCES", silent)
    after = failure()
    assert after["status"] == "the shadowing orbit: …; …"
    assert (after["fault"], after["wraps"]) == (before["fault"], before["wraps"])
