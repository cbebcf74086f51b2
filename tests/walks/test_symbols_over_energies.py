"""Changes of the connection that a symbol selects, and connections followed in energy."""

import shlex

import pytest
from command_line import dpcontrol

from dpcontrol.foundation.version import PACKAGE
from dpcontrol.plans.model import load_model
from dpcontrol.walks.following import SymbolBranches
from dpcontrol.walks.symbols import parse_symbol

COMMAND = 'dpcontrol walk printed --energy 0.1905 -s "down-up +" --compare 0.1915'
PAGE = (PACKAGE / "guide" / "walks.md").read_text(encoding="utf-8")


@pytest.fixture(scope="module")
def printed():
    system = load_model("printed").system
    return SymbolBranches(system, parse_symbol("down-up +", system.saddles))


@pytest.mark.slow
def test_a_change_of_the_selected_motion_is_reported_with_its_energy(printed):
    """The guide shows the change."""
    ended = dpcontrol(*shlex.split(COMMAND)[1:], "--json")
    assert ended.code == 0
    (change,) = ended.document["symbol_changes"]
    assert f'$ {COMMAND}\n"down-up +" selects another connection beyond {change["energy"]:.5f}…\n' in PAGE
    # Independently of continuation, the selected points on the section differ on both sides of the change.
    below, above = (printed.chosen(change["energy"] + way * 2 * max(change["within"], 1e-6)) for way in (-1, 1))
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
