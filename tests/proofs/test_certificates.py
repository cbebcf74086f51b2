"""Independent code confirms certificates, and rejects corruptions with exit code 1, also if they are sealed."""

import contextlib
import json
import subprocess
import sys
from collections.abc import Callable
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from command_line import dpcontrol

pytest.importorskip("flint")

from dpcontrol.proofs.balls import NotClosed, flint, symmetric, working
from dpcontrol.proofs.check import _Pendulum, _trace_of_product, check, digest
from dpcontrol.proofs.statements import statement
from dpcontrol.proofs.symbols import Enclosed, check_symbols

Change = Callable[[dict[str, Any]], None]


@pytest.fixture(scope="module")
def lab(certificates: dict[str, dict[str, Any]]) -> dict[str, Any]:
    return certificates["orbit"]


def shifted(text: str, by: str) -> str:
    return str(float(Fraction(text) + Fraction(by)))


def put(*path: Any, by: str = "", value: Any = None) -> Change:
    """Return a function that changes one entry by a number or to a value; None removes it."""

    def change(content: dict[str, Any]) -> None:
        place: Any = content
        for key in path[:-1]:
            place = place[key]
        if by:
            place[path[-1]] = shifted(place[path[-1]], by)
        elif value is None:
            del place[path[-1]]
        else:
            place[path[-1]] = value

    return change


UNREADABLE = {
    "format": put("format", value="dpcontrol proof 2"),
    "no nodes": put("nodes"),
    "a node less": put("nodes", 2),
    "a component less": put("nodes", 2, 3),
    "no mass": put("system", "mass"),
    "another system": put("system", "equations", value="triple pendulum"),
    "no number": put("durations", 1, value="soon"),
    "no radius": put("exists"),
    "exists beyond unique": put("exists", value="1e-3"),
    "a negative duration": put("durations", 0, value="-0.1"),
    "turns of a rate": put("turns", value=[0, 0, 1, 0]),
    "more nodes than supported": put("nodes", value=[["0"] * 4] * 5000),
    "work without end": put("durations", 0, value="1e9"),
    "an energy that its statement lacks": put("energy", by="1e-9"),
    "another statement": put("statement", value="lab has a closed orbit at the energy -0.06"),
    "a statement on symbols": put("statement", value="… at the energy -0.07 that follows down-up + with wraps [1]"),
    "a radius of zero": put("exists", value="0"),
    "a negative radius": put("unique", value="-1e-10"),
    "no finite radius": put("unique", value=float("nan")),
    "infinity": put("nodes", 0, 0, value=float("inf")),
    "words for a number": put("scale", 0, value="nan"),
    "a number too long": put("period", 0, value="1" * 1300),
    "an exponent without end": put("durations", 0, value="1e999999999"),
    "nested lists": put("normals", value=[[[["0"]]]] * 8),
    "a list of parameters": put("system", value=["mass"]),
    "symbols that are a number": put("symbols", value=1),
    "symbols that are text": put("symbols", value="down-up +"),
    "masses of zero": put("system", "mass", value=["0", "0"]),
    "three masses": put("system", "mass", value=["1", "1", "1"]),
}
UNTRUE = {
    "a node's tenth digit": put("nodes", 2, 1, by="1e-9"),
    "a rate's eleventh digit": put("nodes", 4, 2, by="1e-9"),
    "a smaller radius": put("exists", value="1e-30"),
    "a huge ball": put("unique", value="1e-2"),
    "a mass": put("system", "mass", 0, by="1e-8"),
    "an inertia": put("system", "inertia", 1, by="1e-10"),
    "gravity": put("system", "gravity", 0, by="1e-7"),
    "the energy": put("energy", value="-0.070000001"),
    "a duration": put("durations", 3, by="1e-9"),
    "a turn": put("turns", value=[0, 1, 0, 0]),
    "the period": put("period", 0, by="1e-9"),
    "the multiplier": put("multiplier_exceeds", value="600"),
    "no plane": put("normals", 0, value=["0", "0", "0", "0"]),
}
FALSE_SYMBOLS = {
    "no hits": put("symbols", 0, "hits"),
    "hits": put("symbols", 0, "hits", value=[1, 2]),
    "wraps": put("symbols", 0, "wraps", value=1),
    "the stop's turns": put("symbols", 0, "stop_turns", value=[0, 2, 0, 0]),
    "the stop": put("symbols", 0, "stop", 1, value="-3.2"),
    "another connection": put("symbols", 0, "states", 0, value=["0.5088", "0", "12.4332", "-16.986"]),
    "another section": put("symbols", 0, "section", "normal", value=["1", "0", "0", "0"]),
    "no section": put("symbols", 0, "section"),
    "the marked node": put("symbols", 0, "node", value=0),
    "fewer segments": put("symbols", 0, "segments", value=[0, 5]),
}


@pytest.mark.slow
def test_the_check_runs_without_the_search(lab: dict[str, Any], tmp_path: Path) -> None:
    """A corrupted certificate is still rejected, and a valid one confirmed, if the modules of the search are absent."""
    search = ("flow", "charts", "periodic", "connect", "prove")
    lines = [
        "import json, sys",
        *(f"sys.modules['dpcontrol.proofs.{name}'] = None" for name in search),
        "from dpcontrol.proofs.check import check, digest",
        "content = json.load(open(sys.argv[1]))",
        "assert check(content).proved",
        "content['durations'][3] = '0.1'",
        "assert not check({**content, 'digest': digest(content)}).proved",
    ]
    file = tmp_path / "proof.json"
    file.write_text(json.dumps(lab), encoding="utf-8")
    done = subprocess.run([sys.executable, "-c", "\n".join(lines), file], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr


def test_the_trace_of_a_long_product_is_enclosed_sharply() -> None:
    """Derivatives grow five times along one direction that turns, in coordinates that are not orthogonal."""
    generator = np.random.default_rng(4)
    frames = [generator.normal(size=(4, 4)) for _ in range(100)]
    with working(140):
        exact = [flint.arb_mat(frame.tolist()) for frame in frames]
        growth = flint.arb_mat(np.diag([5.0, 0.2, 1.0, 1.0]).tolist())
        error = flint.arb_mat(4, 4, [symmetric(flint.arb(1e-9))] * 16)
        maps = [exact[(k + 1) % 100] * growth * exact[k].inv() + error for k in range(100)]
        found = _trace_of_product(maps) / flint.arb(5) ** 100
        assert found.contains(1)
        assert found.rad() < 0.01


def corrupted(content: dict[str, Any], change: Change, *, sealed: bool) -> dict[str, Any]:
    """Return a changed copy, with the statement of its numbers and a valid digest if it is sealed."""
    copy = json.loads(json.dumps(content))
    change(copy)
    if sealed and copy.get("statement") == content["statement"]:
        with contextlib.suppress(LookupError, TypeError, ValueError, AttributeError, ArithmeticError), working(140):
            copy["statement"] = statement(copy)
    return {**copy, "digest": digest(copy)} if sealed else copy


def rejected(content: dict[str, Any]) -> bool:
    found = check(content)
    return not found.proved and found.status.startswith("rejected: ") and found.statement is None


@pytest.mark.slow
@pytest.mark.parametrize("name", ["a node less", "a node's tenth digit"])
def test_a_corrupted_file_is_rejected_by_its_digest_with_exit_code_1(
    lab: dict[str, Any], name: str, tmp_path: Path
) -> None:
    file = tmp_path / "proof.json"
    file.write_text(json.dumps(corrupted(lab, (UNREADABLE | UNTRUE)[name], sealed=False)), encoding="utf-8")
    ended = dpcontrol("prove", "check", file)
    assert ended.code == 1
    assert ended.message.startswith("dpcontrol: rejected: ")


@pytest.mark.slow
@pytest.mark.usefixtures("remembered")
@pytest.mark.parametrize("name", [*UNREADABLE, *UNTRUE])
def test_inconsistent_content_and_false_statements_are_rejected_despite_a_valid_digest(
    lab: dict[str, Any], name: str
) -> None:
    assert rejected(corrupted(lab, (UNREADABLE | UNTRUE)[name], sealed=True))


@pytest.mark.slow
@pytest.mark.usefixtures("remembered")
def test_the_check_confirms_a_walk_and_rejects_false_symbols(
    certificates: dict[str, dict[str, Any]], monkeypatch: pytest.MonkeyPatch
) -> None:
    """The flight is enclosed once; false claims are then compared with its boxes."""
    walk = certificates["walk"]
    flights: list[Enclosed] = []

    def kept(claims: Any, enclosed: Enclosed) -> None:
        flights.append(enclosed)
        check_symbols(claims, enclosed)

    monkeypatch.setattr("dpcontrol.proofs.check.check_symbols", kept)
    assert "symbol 1: from within half a turn" in str(check(walk).statement)
    assert "symbol" not in str(check(corrupted(walk, put("symbols", value=[]), sealed=True)).statement)
    for change in FALSE_SYMBOLS.values():
        content = corrupted(walk, change, sealed=True)
        # Flights are enclosed at the precision of the check.
        with working(140), pytest.raises((NotClosed, LookupError, ValueError)):
            check_symbols(content["symbols"], flights[0])


@pytest.mark.slow
def test_the_check_confirms_three_bodies_and_rejects_another_mass(certificates: dict[str, dict[str, Any]]) -> None:
    content = certificates["three bodies"]
    assert "exactly one orbit of the three bodies closes" in str(check(content).statement)
    assert rejected(corrupted(content, put("system", "mass_ratio", 0, by="1e-9"), sealed=True))


def test_states_at_rest_have_energies(lab: dict[str, Any]) -> None:
    """Nodes at turning points have rates of exactly 0.0, whose balls have no powers in flint."""
    with working(140):
        flow = _Pendulum(lab["system"])
        still = flow.energy([*map(flint.arb, (0.7, 3.5)), flint.arb(0, 1e-7), flint.arb(0, 1e-7)])
        rates, slopes = flow.slopes([*map(flint.arb, (0.7, 3.5)), flint.arb(0, 1e-7), flint.arb(0, 1e-7)])
    values = [still.value, *still.partials, *rates, *slopes.entries()]
    assert all(value.is_finite() for value in values)
