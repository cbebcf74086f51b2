"""The longest interval of a mesh: predicted by the method's order from one finer mesh, named beyond it."""

import pytest

from dpcontrol.bench.edges import TOLERANCE, mesh_border, on_equal_intervals, problem_of

APART = 0.25  # the bar


@pytest.mark.benchmark
def test_the_error_between_nodes_passes_the_tolerance_where_the_order_has_it():
    found = mesh_border(1.0, x=1.0)
    assert found.off is not None
    assert found.off < APART
    assert found.near is not None
    assert found.far is not None
    near, far = (on_equal_intervals(problem_of(), h) for h in (found.near, 1.5 * found.far))
    assert near.converged
    assert near.max_error_between_nodes <= TOLERANCE
    assert not far.converged
    assert "error between nodes" in far.status
    assert "start with a shorter interval" in far.status
