"""Work of hours or gigabytes is rejected with an estimate of its cost, and starts with --yes."""

from pathlib import Path

import pytest
from command_line import dpcontrol

import dpcontrol as dp
from dpcontrol.foundation.progress import MOST_BYTES, MOST_SECONDS
from dpcontrol.plans.itinerary import load_itinerary
from dpcontrol.plans.plan import plan_cost

WALK = ("walk", "lab", "--energy", "0.2")
TURN = ("-s", "down-up +")


@pytest.mark.parametrize(
    ("call", "key"),
    [
        ((*WALK, *TURN, *TURN, "--wraps", "1000000", "--solve"), "wraps"),
        ((*WALK, *(TURN * 5000), "--solve"), "symbols"),
        ((*WALK, "--random", "1000000"), "random"),
        ((*WALK, "--random", "100", "--lengths", "1", "1000000"), "lengths"),
        (("bifurcations", "lab", "--from", "down-up", "--to", "down-up", "--energies", "-0.11", "-0.09", "--samples",
          "1000000"), "samples"),
        ((*WALK, "--hits", "9,9", "--length", "1"), "hits up to 9,9: up to 243 searches"),
        (("import", "--simulated", "lab", "--swings", "1000", "--seconds", "1000"), "swings"),
    ],
    ids=["wraps", "symbols", "random", "lengths", "samples", "hits", "swings"],
)  # fmt: skip
def test_endless_work_is_rejected_before_it_starts(call: tuple[str, ...], key: str) -> None:
    ended = dpcontrol(*call)
    assert ended.code == 2
    assert ended.message.startswith(f"dpcontrol: {key}")
    assert "will take about" in ended.message


def test_shipped_itineraries_are_planned_without_yes() -> None:
    for file in Path(dp.__file__).parent.parent.joinpath("itineraries").glob("*.toml"):
        foretold = plan_cost(load_itinerary(str(file)))
        # Fifty-six transfers of three arms take a quarter of an hour.
        assert foretold.seconds < MOST_SECONDS / (3 if file.stem == "fifty-six" else 10)
        assert foretold.memory < MOST_BYTES / 4
