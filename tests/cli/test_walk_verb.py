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
KEYS = {
    "walk", "wraps", "wraps_realised", "periodic", "residual", "duration", "seconds", "iterations", "status",
}  # fmt: skip
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


def refused(*arguments: str | Path, naming: str) -> None:
    """Check that a call ends with 2 and one sentence that names `naming`."""
    ended = dpcontrol(*arguments)
    assert ended.code == 2
    assert ended.stdout == ""
    said = [line for line in ended.stderr.splitlines() if line.startswith("dpcontrol: ")]
    assert len(said) == 1
    assert said[0] == ended.message
    assert naming in said[0]
    assert "Traceback" not in ended.stderr


@pytest.mark.slow
def test_walks_that_are_drawn_and_solved_have_the_keys_that_are_promised(graphs: dict[Any, Any]) -> None:
    drawing = ("--random", "4", "--lengths", "1", "5", "--extra-wraps", "0", "4", "--seed", "7", "--solve", "--json")
    first = dpcontrol(*HIGH, *drawing)
    # The same again from the very beginning.
    graphs.clear()
    second = dpcontrol(*HIGH, *drawing)
    assert first.code == second.code == 0
    walks, again = first.document["walks"], second.document["walks"]
    assert len(walks) == 4
    for walk in walks:
        assert set(walk) >= KEYS
        assert 1 <= len(walk["walk"]) <= 5
        assert walk["wraps_realised"] == walk["wraps"]
        assert len(walk["wraps"]) == len(walk["walk"]) - 1
        more = [n - least for n, least in zip(walk["wraps"], walk["least_wraps"], strict=True)]
        assert all(0 <= n <= 4 for n in more)
        assert walk["periodic"] is False
        assert 0 <= walk["residual"] <= RESIDUAL
        assert walk["duration"] > walk["symbol_times"][-1] > 0
        assert walk["seconds"] > 0
        assert walk["status"].startswith("converged")
        h = walk["certificate"]["kantorovich"]
        assert h is None or h < 0.5
        ends = [(name.split(">")[0], name.split(">")[1].split("[")[0]) for name in walk["walk"]]
        assert all(a[1] == b[0] for a, b in pairwise(ends))
    for walk in (*walks, *again):
        del walk["seconds"]
    assert again == walks
    other = dpcontrol(*HIGH, *drawing[:8], "--seed", "8", "--json").document["walks"]
    assert [w["walk"] for w in other] != [w["walk"] for w in walks]


def test_closed_walks_have_a_stop_more_and_reciprocal_multipliers() -> None:
    drawing = ("--random", "3", "--lengths", "1", "3", "--seed", "2", "--periodic", "--solve", "--json")
    for walk in dpcontrol(*LOW, *drawing).document["walks"]:
        assert walk["periodic"] is True
        assert len(walk["wraps"]) == len(walk["walk"])
        assert walk["wraps_realised"] == walk["wraps"]
        assert abs(walk["certificate"]["multipliers"]["reciprocity"]) < 1e-6


def test_counts_of_walks_are_those_of_the_graph() -> None:
    shown = dpcontrol(*HIGH, "--json").document
    edges = shown["edges"]
    names = sorted({e["from"] for e in edges})
    counts = np.array([[sum(e["from"] == a and e["to"] == b for e in edges) for b in names] for a in names])
    for length in (1, 2, 5):
        assert shown["walks_by_length"][str(length)] == np.linalg.matrix_power(counts, length).sum()
    listed = dpcontrol(*HIGH, "--length", "2", "--from", "down-up", "--to", "up-down", "--json").document
    a, b = names.index("down-up"), names.index("up-down")
    assert listed["count"] == len(listed["walks"]) == (counts @ counts)[a, b]
    assert len({tuple(w["walk"]) for w in listed["walks"]}) == listed["count"]


def test_wraps_and_leads_lengthen_an_orbit_by_whole_periods() -> None:
    def lasts(wraps: str, *leads: str) -> float:
        ended = dpcontrol(*LOW, *TURN, *BACK, "--wraps", wraps, *leads, "--solve", "--json")
        (walk,) = ended.document["walks"]
        return walk["duration"]

    period = dpcontrol("orbit", "lab", "--saddle", "down-up", "--energy", "-0.07", "--json").document["period"]
    base = lasts("1")
    # The wobble's length tends to the period as λ^-N.
    assert lasts("3") - base == pytest.approx(2 * period, abs=1e-3)
    assert lasts("1", "--lead-in", "0", "--lead-out", "5") - base == pytest.approx(period, abs=1e-9)


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
def test_extended_precision_gives_people_the_period_of_a_closed_walk() -> None:
    ended = dpcontrol(*LOW, *TURN, "--periodic", "--wraps", "0", "--solve", "--precision", "extended")
    assert ended.code == 0
    assert "in 113-bit arithmetic: refined in" in ended.stdout
    said = [line.split() for line in ended.stdout.splitlines() if line.startswith("    ")]
    assert [words[:-1] for words in said] == [["position", "1"], ["position", "2"], ["rate", "1"], ["rate", "2"],
                                              ["period"]]  # fmt: skip
    assert all(len(words[-1]) > 30 for words in said)


@pytest.mark.slow
def test_a_walk_can_name_grown_edges_and_rotating_orbits() -> None:
    ended = dpcontrol(*LOW, "-s", "(down-up +)·1·(down-up -)", *TURN, "--wraps", "2", "--solve", "--json")
    plain = dpcontrol(*LOW, *TURN, *BACK, *TURN, "--wraps", "1,2", "--solve", "--json")
    (grown,), (other,) = ended.document["walks"], plain.document["walks"]
    assert grown["wraps_realised"] == [2]
    assert "@(down-up>down-up[0,1]h1.1@" in grown["walk"][0]
    lasts = [walk["symbol_times"][-1] - walk["symbol_times"][0] for walk in (grown, other)]
    assert lasts[0] == pytest.approx(lasts[1], abs=AGREES)
    # The edge of a solved walk can be a symbol at once.
    assert other["edge"] == "·".join(f"({n})" if isinstance(n, str) else str(n) for n in
                                     (other["walk"][0], 1, other["walk"][1], 2, other["walk"][2]))  # fmt: skip
    assert dpcontrol(*LOW, "-s", other["edge"], "--solve").code == 0
    turning = ("-s", "down-up > outer-rotating", "-s", "outer-rotating > down-up", "--wraps", "3")
    (walk,) = dpcontrol("walk", "lab", "--energy", "-0.06985", *turning, "--solve", "--json").document["walks"]
    assert walk["wraps_realised"] == [3]
    assert walk["residual"] <= RESIDUAL
    assert walk["walk"][0].startswith("down-up>outer-rotating[")


def test_a_picture_is_drawn_of_one_walk(tmp_path: Path) -> None:
    file = tmp_path / "walk.png"
    ended = dpcontrol(*LOW, *TURN, "--solve", "--picture", file)
    assert ended.code == 0
    assert f"drawn to {file}" in ended.stdout
    assert file.read_bytes().startswith(b"\x89PNG\r\n\x1a\n")
    again = dpcontrol(*LOW, *TURN, "--periodic", "--solve", "--picture", file, "--json")
    assert again.document["picture"] == str(file)


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
        ((*LOW, "-s", "sideways +"), "choose from down-up, up-down"),
        ((*LOW, "-s", "down-up>down-up[0,1]h1.1@0.0000,-9.9"), "available: down-up>down-up[0,-1]h1.1@"),
        ((*LOW, *TURN, "-s", "up-down -"), 'put "down-up > up-down" between them'),
        ((*LOW, *TURN, *BACK, "--wraps", "1,2", "--solve"), "1 interior stop"),
        ((*LOW, *TURN, *BACK, "--wraps", "", "--solve"), "wraps = []"),
        ((*LOW, *TURN, *BACK, "--wraps", "-1", "--solve"), "zero or more"),
        ((*LOW, *TURN, *BACK, "--periodic", "--wraps", "1", "--solve"), "2 stops if closed"),
        ((*HIGH, "-s", "down-up > up-down", "--periodic", "--solve"), "must end where it starts"),
        ((*LOW, "--random", "2", "--wraps", "1"), "--extra-wraps"),
        ((*LOW, "--random", "2", "--lengths", "5", "2"), "lengths 5 to 2"),
        ((*LOW, "--random", "2", "--extra-wraps", "3", "1"), "extra wraps 3 to 1"),
        ((*LOW, *TURN, "--through", "down-up"), "give one of them"),
        ((*LOW, "--through", "down-up"), "at least two"),
        ((*LOW, "--length", "9"), "draw some with --random"),
        ((*LOW, "--solve"), "give -s"),
        (("walk", "lab", "--energy", "-0.2", "--random", "2"), "-0.1754297468841"),
        (("walk", "lab", "--energy", "nan"), "finite"),
        ((*LOW, "-s", "up-down +"), "the nearest existing walk is 'down-up>down-up[0,1]h1.1@0.0000,-9.9100'"),
        ((*LOW, *TURN, "-s", "down-up > up-down"), "symbol 2 of 2"),
        ((*LOW, "--through", "down-up", "--through", "up-down"), "has no orbit at -0.07 J"),
        ((*LOW, *TURN, "--out", "x"), "--solve"),
        ((*LOW, *TURN, "--precision", "extended"), "--solve"),
        ((*LOW, "--length", "1", "--solve", "--precision", "extended"), "8 walks; at most 4 are possible"),
        ((*LOW, "-s", "down-up > inner-rotating"), "0 orbits were found that rotate the inner arm"),
        ((*LOW, "-s", "outer-rotating +"), "go by way of a saddle"),
        ((*LOW, "-s", "down-up>down-up[0,1]h1.2:inner@0,0"), "did you mean 'inner-down'?"),
        ((*LOW, "-s", "(down-up +)·1·(up-down +)"), 'put "down-up > up-down" between them'),
        ((*LOW, *TURN, "--picture", "x.png"), "--solve"),
        ((*LOW, *TURN, "--solve", "--picture", "x.jpg"), ".png"),
        ((*LOW, "--random", "2", "--solve", "--picture", "x.png"), "here are 2"),
        ((*LOW, *TURN, "--solve", "--out", "taken/x"), "cannot use taken/x: Not a directory"),
        ((*LOW, *TURN, "--solve", "--picture", "taken/x.png"), "cannot use taken/x.png: Not a directory"),
    ],
)
def test_a_user_error_is_rejected_in_one_sentence_and_leaves_nothing(
    arguments: tuple[str, ...], naming: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("taken").write_text("")
    refused(*arguments, naming=naming)
    assert [str(f.relative_to(tmp_path)) for f in tmp_path.rglob("*")] == ["taken"]
