"""Random itineraries at 0.2 J, a sample of the two hundred in tests/benchmarks/test_references.py."""

import pytest
from walk_references import complaints, random_references

from dpcontrol.plans.model import load_model
from dpcontrol.references.problem import ReferenceSettings
from dpcontrol.walks.edges import find_edges


@pytest.mark.slow
def test_random_itineraries_converge_with_the_stops_of_their_walks() -> None:
    model = load_model("lab")
    edges = find_edges(model.system, 0.2)
    settings = ReferenceSettings(method="radau-7", interval=0.05)
    found = list(random_references(model, edges, 3, seed=4, lengths=(1, 3), settings=settings))
    assert [text for followed in found for text in complaints(model, followed)] == []
    for followed in found:
        assert followed.reference.max_error_between_nodes <= settings.tolerance
        assert followed.reference.max_cart_position <= 0.4
    assert max(len(followed.orbit.walk) for followed in found) > 1
    assert len({followed.friction for followed in found}) == 3
