"""References whose last orbit friction moves: the pendulum is free at their end."""

from pathlib import Path

import numpy as np
import pytest

from dpcontrol.plans.itinerary import load_itinerary
from dpcontrol.plans.plan import make_plan
from dpcontrol.references.reference import plan_notes

MODEL = """title = "Arms with strong friction"
system = "arm-chain"
[arms]
source = "drawn"
mass = [0.198806, 0.258972]
centre_of_mass = [0.104927, 0.133603]
length = [0.299658, 0.230375]
inertia = [0.00180642, 0.00108735]
[gravity]
source = "standard"
acceleration = 9.81
[friction]
source = "drawn"
viscous = [0.0214485, 0.00140563]
coulomb = [0.00963224, 0.00350537]
smoothing = 0.05199
"""
SCENE = """model = "model.toml"
start = "orbit"
finish = "orbit"
energy = -0.494188
walk = ["down-up -"]
lead_in = 1
lead_out = 3
[limits]
position = 0.692
velocity = 3.62
acceleration = 34.3
"""


@pytest.mark.slow
def test_a_reference_stays_on_its_last_orbit_and_ends_with_the_cart_at_rest(tmp_path: Path) -> None:
    (tmp_path / "model.toml").write_text(MODEL)
    (tmp_path / "scene.toml").write_text(SCENE)
    # A plan that leaves the orbit is refused: it did so by 0.2 rad while its end was fixed.
    reference = make_plan(load_itinerary(str(tmp_path / "scene.toml")), fresh=True).reference
    assert reference.converged
    assert reference.state(reference.duration)[-2:] == pytest.approx([0.0, 0.0], abs=1e-6)
    assert plan_notes(reference)["orbits"]
    assert np.isfinite(reference.inputs).all()
