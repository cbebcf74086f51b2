"""The tracking law of the turn, which several files run."""

import pytest
from shadowing_stand_in import LAB

from dpcontrol.control.interface import sampled_model
from dpcontrol.control.tracking import TrackingController, TvlqrSettings, tracking_controller
from dpcontrol.references.reference import Reference


@pytest.fixture(scope="session")
def controller(reference: Reference) -> TrackingController:
    return tracking_controller(reference, sampled_model(LAB, 1000.0), TvlqrSettings())
