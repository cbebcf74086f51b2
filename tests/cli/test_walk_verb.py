"""`dpcontrol walk`: what it lists, draws and solves, what it writes, and what it refuses."""

import json
from decimal import Decimal
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from command_line import dpcontrol
from independent_pendulum import flow

from dpcontrol.dynamics.system import System
from dpcontrol.foundation.progress import Progress
from dpcontrol.walks import edges

RESIDUAL = 1e-11
EXTENDED_RESIDUAL = 1e-20
AGREES = 1e-10
"""The bar; what is reached is about 1e-32, and 1e-13 off double."""
BETWEEN_NODES = 1e-9
"""From node to node by an independent integrator at 1e-12 relative; the segments are an eighth of a period long."""
LOW = ("walk", "lab", "--energy", "-0.07")
HIGH = ("walk", "lab", "--energy", "0.2")
TURN = ("-s", "down-up +")
BACK = ("-s", "down-up -")


@pytest.fixture(scope="module")
def graphs() -> dict[Any, Any]:
    """Graphs by the arguments of their search."""
    return {}


@pytest.fixture(autouse=True)
def each_graph_once(graphs: dict[Any, Any], monkeypatch: pytest.MonkeyPatch) -> None:
    """Share the search of each graph between all calls, most of which test later steps."""

    def found(system: System, energy: float, *, hits: Any, symbols: Any, yes: bool, progress: Progress) -> edges.Edges:
        key = (system.name, energy, *sorted(hits), *symbols)
        if key not in graphs:
            graphs[key] = search(system, energy, hits=hits, symbols=symbols, yes=yes, progress=progress)
        return graphs[key]

    search = edges.find_edges
    monkeypatch.setattr(edges, "find_edges", found)


@pytest.mark.slow
def test_walks_that_are_drawn_and_solved_are_those_of_their_seed(graphs: dict[Any, Any]) -> None:
    drawing = (*HIGH, "--random", "4", "--lengths", "1", "5", "--extra-wraps", "0", "4", "--solve", "--json", "--seed")
    walks = dpcontrol(*drawing, "7").document["walks"]
    # The same again from the very beginning.
    graphs.clear()
    again = dpcontrol(*drawing, "7").document["walks"]
    assert len(walks) == 4
    for walk in walks:
        assert 1 <= len(walk["walk"]) <= 5
        assert walk["wraps_realised"] == walk["wraps"]
        assert len(walk["wraps"]) == len(walk["walk"]) - 1
        more = [n - least for n, least in zip(walk["wraps"], walk["least_wraps"], strict=True)]
        assert all(0 <= n <= 4 for n in more)
        assert 0 <= walk["residual"] <= RESIDUAL
        assert walk["duration"] > walk["symbol_times"][-1] > 0
        h = walk["certificate"]["kantorovich"]
        assert h is None or h < 0.5
        ends = [(name.split(">")[0], name.split(">")[1].split("[")[0]) for name in walk["walk"]]
        assert all(a[1] == b[0] for a, b in pairwise(ends))
    for walk in (*walks, *again):
        del walk["seconds"]
    assert again == walks
    other = dpcontrol(*drawing, "8").document["walks"]
    assert [w["walk"] for w in other] != [w["walk"] for w in walks]


def test_walks_are_listed_as_often_as_the_graph_has_them() -> None:
    edges = dpcontrol(*HIGH, "--json").document["edges"]
    names = sorted({e["from"] for e in edges})
    counts = np.array([[sum(e["from"] == a and e["to"] == b for e in edges) for b in names] for a in names])
    listed = dpcontrol(*HIGH, "--length", "2", "--from", "down-up", "--to", "up-down", "--json").document
    a, b = names.index("down-up"), names.index("up-down")
    assert listed["count"] == len(listed["walks"]) == (counts @ counts)[a, b]
    assert len({tuple(w["walk"]) for w in listed["walks"]}) == listed["count"]


def test_numpy_reads_the_output_which_satisfies_the_equations(tmp_path: Path) -> None:
    ended = dpcontrol(*LOW, *TURN, *BACK, "--wraps", "1", "--solve", "--out", tmp_path / "orbits", "--json")
    (walk,) = ended.document["walks"]
    assert walk["file"] == str(tmp_path / "orbits" / "walk-1.npz")
    with np.load(walk["file"], allow_pickle=False) as arrays:
        header = json.loads(str(arrays["header"]))
        times, states, symbol_times, turn = (arrays[k] for k in ("times", "states", "symbol_times", "turn"))
    assert (header["model"], header["energy"], header["walk"]) == ("lab", -0.07, walk["walk"])
    assert (header["wraps"], header["wraps_realised"], header["periodic"]) == ([1], [1], False)
    assert symbol_times.tolist() == walk["symbol_times"]
    assert turn.tolist() == [0, 0, 0, 0]
    assert states.shape == (len(times), 4)
    assert (np.diff(times) > 0).all()
    for k in range(0, len(times) - 1, 5):
        flown = flow(states[k], times[k + 1] - times[k])
        assert np.abs(flown[-1] - states[k + 1]).max() < BETWEEN_NODES
    # The section of Down-Up's connections: the outer arm passes straight down.
    for time in symbol_times:
        node = states[np.argmin(np.abs(times - time))]
        assert abs(np.angle(np.exp(1j * node[1]))) < BETWEEN_NODES


@pytest.mark.slow
def test_extended_precision_gives_digits_that_agree_with_double(tmp_path: Path) -> None:
    asked = ("--solve", "--precision", "extended", "--out", tmp_path)
    ended = dpcontrol(*LOW, *TURN, *BACK, "--wraps", "1", *asked, "--json")
    (walk,) = ended.document["walks"]
    assert ended.code == 0
    assert walk["precision"] == "extended"
    assert float(walk["residual"]) <= EXTENDED_RESIDUAL
    assert walk["residual_double"] <= RESIDUAL
    assert walk["correction"] <= AGREES
    assert all(isinstance(text, str) for text in walk["state"])
    assert [float(text) for text in walk["state"]] == pytest.approx(walk["state_double"], abs=AGREES)
    # The outer arm hangs straight down on the section, a turn on: 2π by OEIS A019692.
    assert abs(Decimal(walk["state"][1]) - Decimal("6.2831853071795864769252867665590")) < Decimal("1e-30")
    times = [float(text) for text in walk["symbol_times_digits"]]
    assert np.diff(times) == pytest.approx(np.diff(walk["symbol_times"]), abs=AGREES)
    assert walk["period"] is None
    with np.load(walk["file"], allow_pickle=False) as arrays:
        digits, seconds = arrays["states_digits"], arrays["times_digits"]
        assert digits.shape == (len(seconds), 4)
        node = int(np.argmin(np.abs(seconds.astype(float))))
    assert digits[node].tolist() == walk["state"]


@pytest.mark.slow
def test_the_edge_of_a_solved_walk_is_a_symbol_of_others() -> None:
    asked = (*LOW, *TURN, *BACK, *TURN, "--wraps", "1,2", "--solve", "--json")
    (plain,) = dpcontrol(*asked).document["walks"]
    ended = dpcontrol(*LOW, "-s", "(down-up +)·1·(down-up -)", *TURN, "--wraps", "2", "--solve", "--json")
    (grown,) = ended.document["walks"]
    assert grown["wraps_realised"] == [2]
    lasts = [walk["symbol_times"][-1] - walk["symbol_times"][0] for walk in (grown, plain)]
    assert lasts[0] == pytest.approx(lasts[1], abs=AGREES)
    assert dpcontrol(*LOW, "-s", plain["edge"], "--solve").code == 0


@pytest.mark.slow
def test_a_walk_that_does_not_converge_ends_with_1_its_reason_and_the_least_wraps(tmp_path: Path) -> None:
    # A hair above the saddle-node at which the inner arm's turns are born the pair's members all but touch.
    born = ("walk", "lab", "--energy", "0.17807033", "-s", "up-down +", "-s", "up-down +", "--solve", "--json")
    files = ("--out", tmp_path / "orbits", "--picture", tmp_path / "walk.png")
    ended = dpcontrol(*born, "--wraps", "0", *files)
    assert ended.code == 1
    (walk,) = ended.document["walks"]
    assert walk["converged"] is False
    assert "symbol 1 of 2" in walk["status"]
    assert "too few: must be at least [" in walk["status"]
    assert "0 of 1 walks converged" in ended.message
    assert "symbol 1 of 2" in ended.message
    assert list(tmp_path.iterdir()) == []
    (least,) = json.loads(walk["status"].rpartition("least ")[2])
    assert dpcontrol(*born, "--wraps", str(least)).code == 0


@pytest.mark.parametrize(
    ("arguments", "naming"),
    [
        ((*LOW, "-s", "down-up*"), "'down-up*' is not a symbol"),
        ((*LOW, "-s", 200 * "(" + "down-up +" + 200 * ")"), "at most 20 deep"),
        ((*LOW, *TURN, "-s", "up-down -"), 'put "down-up > up-down" between them'),
        ((*LOW, "--random", "2", "--lengths", "5", "2"), "lengths 5 to 2"),
        ((*LOW, "-s", "down-up > inner-rotating"), "0 orbits were found that rotate the inner arm"),
        ((*LOW, *TURN, "--solve", "--out", "taken/x"), "taken/x"),
    ],
)
def test_a_user_error_is_rejected_and_leaves_nothing(
    arguments: tuple[str, ...], naming: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("taken").write_text("")
    ended = dpcontrol(*arguments)
    assert (ended.code, ended.stdout) == (2, "")
    assert naming in ended.message
    assert [file.name for file in tmp_path.rglob("*")] == ["taken"]
