"""Each cause of a search has a sentence, and no verdict depends on the sentences."""

from enum import StrEnum
from typing import Any

import pytest

from dpcontrol.foundation import causes
from dpcontrol.foundation.errors import GoalMissed
from dpcontrol.planner.worker import failure_of
from dpcontrol.plans.itinerary import itinerary_from
from dpcontrol.plans.model import load_model
from dpcontrol.plans.planning import shadowing_orbit
from dpcontrol.words import findings, searches

TURN_BORN = -0.141987140339  # J; saddle-node of turns, where one wrap is needed between two of them
OTHERS = {StrEnum, causes.Cause, causes.Fault, causes.FindingCause}  # The tables of runs and findings have these.
KINDS = [kind for kind in vars(causes).values() if isinstance(kind, type) and issubclass(kind, StrEnum)]
KINDS = [kind for kind in KINDS if kind not in OTHERS]


@pytest.mark.parametrize("kind", KINDS)
def test_each_cause_has_a_sentence(kind: type[StrEnum]) -> None:
    assert set(searches.SENTENCES[kind]) == set(kind)


def test_each_cause_of_a_finding_has_a_sentence() -> None:
    assert {cause for _, cause in findings.FINDINGS} == set(causes.FindingCause)


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
