"""The example in the docstring of every public function runs and prints the documented result."""

import doctest
import inspect
import json
from collections.abc import Iterator
from typing import Any

import pytest

import dpcontrol as dp
from dpcontrol.control import export
from dpcontrol.plans.atlas import make_atlas
from dpcontrol.proofs import prove
from tests.api_reference import FUNCTIONS

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module", autouse=True)
def briefly() -> Iterator[None]:
    """Prove an orbit once for all examples, a single connection of a graph, and do not compile exported code."""
    proofs: dict[float, prove.Proof] = {}
    prove_orbit, prove_network = prove.prove_orbit, prove.prove_network

    def proved(orbit: Any, **settings: Any) -> prove.Proof:
        if orbit.energy not in proofs:
            proofs[orbit.energy] = prove_orbit(orbit, **settings)
        return proofs[orbit.energy]

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(prove, "prove_orbit", proved)
        patch.setattr(prove, "prove_network", lambda kind, found, **others: prove_network(kind, found[:1], **others))
        patch.setattr(export, "_measured", lambda files: (None, None))
        yield


@pytest.fixture(scope="module")
def names(example: dict[str, Any]) -> dict[str, Any]:
    """The names that examples use in addition to `dp`."""
    values = {**example, "planned": example["reference"], "atlas_file": make_atlas(example["lab"], -0.07).file}
    values["campaign_file"] = values["log"].with_name("campaign.parquet")
    dp.campaign(values["reference"], runs=4, mismatch=0.02, workers=1, out=values["campaign_file"])
    values["night_folder"] = values["log"].with_name("night")
    dp.closed_loop("turn-from-rest").night(0.001, values["night_folder"])
    values["certificate_file"] = values["log"].with_name("proof.json")
    proof = dp.prove(values["orbit"])
    values["certificate_file"].write_text(json.dumps(proof.certificate), encoding="utf-8")
    return values


@pytest.mark.parametrize("name", FUNCTIONS)
def test_every_function_has_types_and_an_example_that_runs(name: str, names: dict[str, Any]) -> None:
    function = getattr(dp, name)
    assert all(p.annotation is not p.empty for p in inspect.signature(function).parameters.values())
    assert inspect.signature(function).return_annotation is not inspect.Signature.empty
    (test,) = doctest.DocTestFinder(recurse=False).find(function, name, globs={**names})
    assert test.examples, f"{name} has no example"
    runner = doctest.DocTestRunner(optionflags=doctest.ELLIPSIS)
    said: list[str] = []
    assert runner.run(test, out=said.append).failed == 0, "".join(said)
