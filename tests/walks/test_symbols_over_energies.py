"""Changes of the connection that a symbol selects, and connections followed in energy."""

import pytest
from command_line import dpcontrol

from dpcontrol.plans.model import load_model
from dpcontrol.walks.following import SymbolBranches
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
