"""Changes of the connection that a symbol selects, and connections followed in energy."""

import pytest
from command_line import dpcontrol

from dpcontrol.bench import energies
from dpcontrol.plans.model import load_model
from dpcontrol.walks.following import SymbolBranches, bisected
from dpcontrol.walks.symbols import parse_symbol


@pytest.fixture(scope="module")
def printed():
    system = load_model("printed").system
    return SymbolBranches(system, parse_symbol("down-up +", system.saddles))


@pytest.mark.slow
def test_a_change_of_the_selected_motion_is_reported_with_its_energy(printed):
    shown = dpcontrol("walk", "printed", "--energy", "0.19", "-s", "down-up +", "--compare", "0.195", "--json")
    assert shown.code == 0
    changes = shown.document["symbol_changes"]
    assert [round(one["energy"], 5) for one in changes] == pytest.approx([0.19122, 0.19332], abs=2e-5)
    # Independently of continuation, the selected points on the section differ on both sides of each change.
    for one in changes:
        below, above = (printed.chosen(one["energy"] + way * 2 * max(one["within"], 1e-6)) for way in (-1, 1))
        assert below is not None
        assert above is not None
        assert abs(below.state[2] - above.state[2]) > 0.5


@pytest.mark.slow
def test_a_connection_is_followed_beyond_the_change_of_its_symbol(printed):
    first = printed.chosen(0.19)
    assert first is not None
    there = printed.followed(first, 0.195)
    assert there is not None
    other = printed.chosen(0.195)
    assert other is not None
    assert there.name != other.name
    # The motion is nearly the same, while the other one's rate differs by 26 rad/s.
    assert there.state == pytest.approx(first.state, abs=0.2)
    assert there.transversality_angle == pytest.approx(first.transversality_angle, abs=1.0)
    back = printed.followed(there, 0.19)
    assert back is not None
    assert back.name == first.name


@pytest.mark.slow
def test_a_symbol_with_a_single_motion_has_no_changes():
    system = load_model("lab").system
    branches = SymbolBranches(system, parse_symbol("down-up -", system.saddles))
    assert branches.changes(-0.071, -0.07) == ()
    begin, end = branches.chosen(-0.071), branches.chosen(-0.07)
    assert begin is not None
    assert end is not None
    followed = branches.followed(begin, -0.07)
    assert followed is not None
    assert followed.name == end.name


def test_bisection_works_in_both_directions():
    for low, high in ((0.0, 1.0), (1.0, 0.0)):
        last, first = bisected(low, high, lambda x, low=low: abs(x - low) < 0.3)
        assert abs(last - low) < 0.3 <= abs(first - low)
        assert abs(last - first) < 0.01


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (("--compare", "0.1"), "--compare follows the symbols"),
        (("--compare", "0.1", "-s", "down-up +", "--solve"), "give one of them"),
        (("--compare", "-0.07", "-s", "down-up +"), "other than --energy"),
        (("--compare", "nan", "-s", "down-up +"), "finite"),
    ],
)
def test_invalid_comparisons_are_refused(options, words):
    shown = dpcontrol("walk", "lab", "--energy", "-0.07", *options)
    assert shown.code == 2
    assert words in shown.message


def test_energies_beyond_all_orbits_are_named_and_end_at_once():
    # The orbit's search ends unconverged there; its tubes were propagated for minutes.
    shown = dpcontrol("walk", "lab", "--energy", "-0.07", "-s", "down-up +", "--compare", "2147483648")
    assert shown.code == 0
    assert '"down-up +" selects no connection at 3.57914e+08 J, ' in shown.stderr
    assert "0 changes" in shown.stdout


@pytest.mark.slow
def test_energies_are_compared_along_one_branch(monkeypatch):
    """The walk at each energy names the followed connection, even if its symbol selects another one."""
    from dpcontrol.plans.itinerary import load_itinerary

    itinerary = load_itinerary("outer-turn")
    asked = []

    def planned(_, walk, __):
        asked.append(walk)
        return {"reference": 1.0, "loop": 1.0, "completed": 1.0, "duration": 1.0, "energy": walk.energy}

    monkeypatch.setattr(energies, "at_energy", planned)
    chart = energies.energies_chart(itinerary)
    own = energies.only_walk(itinerary)
    system = itinerary.model.system
    assert "are followed to the other energies" in " ".join(chart.reading)
    for walk in asked:
        for text, named in zip(own.walk, walk.walk, strict=True):
            if walk.energy == own.energy:
                assert named == text
                continue
            branches = SymbolBranches(system, parse_symbol(text, system.saddles))
            back = next(c for c in branches.connections(walk.energy) if c.name == named)
            home = branches.followed(back, own.energy)
            chosen = branches.chosen(own.energy)
            assert home is not None
            assert chosen is not None
            assert home.name == chosen.name
