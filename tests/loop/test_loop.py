import numpy as np
import pytest
from kept_rows import Kept
from shadowing_stand_in import LAB

from dpcontrol.control.estimator_settings import EkfSettings
from dpcontrol.control.interface import sampled_model
from dpcontrol.control.tracking import TrackingController
from dpcontrol.foundation.errors import InputError
from dpcontrol.logs import Event
from dpcontrol.logs.layout import control_fields
from dpcontrol.loop.assembly import Assembly
from dpcontrol.loop.loop import LoopSettings
from dpcontrol.loop.result import Ending, LoopResult, LoopSink, SinkBeside
from dpcontrol.references.reference import Reference

COUNT = 2 * np.pi / 40_000
FIELDS = {name: k for k, name in enumerate(control_fields(2, has_cart=True))}
REAL = LoopSettings(seed=0, mismatch=0.02, initial_error=0.02)


def rms(values: np.ndarray) -> float:
    return float(np.sqrt(np.mean(values**2)))


@pytest.mark.slow
def test_the_right_model_tracks_to_encoder_counts(reference: Reference, controller: TrackingController) -> None:
    # Zeros that have to be found first cost their share.
    for augment, most in (((), COUNT), (("zeros",), 3 * COUNT)):
        settings = LoopSettings(seed=0, estimator=EkfSettings(augment=augment))
        result = Assembly(reference, LAB, settings, law=controller).simulate()
        assert result.ending is Ending.FINISHED
        assert rms((result.ticks.truth - result.ticks.references)[:, :2]) < most
        assert rms(result.ticks.control[:, FIELDS["applied"]]) < 2 * most / COUNT * reference.rms_cart_acceleration


def test_truth_between_ticks_is_the_mismatched_plant_under_the_applied_command(
    reference: Reference, controller: TrackingController
) -> None:
    result = Assembly(reference, LAB, REAL, law=controller).simulate()
    assert result.plant != LAB
    for value, nominal in zip(result.plant.mass, LAB.mass, strict=True):
        assert abs(value / nominal - 1) <= 0.02
    model = sampled_model(result.plant, REAL.rate)
    for k in range(0, len(result.ticks.times) - 1, 501):
        following = model.step(result.ticks.truth[k], float(result.ticks.control[k, FIELDS["applied"]]))
        assert result.ticks.truth[k + 1] == pytest.approx(following, abs=1e-6)
    # The model's own arms would have gone elsewhere.
    own = sampled_model(LAB, REAL.rate).step(result.ticks.truth[0], float(result.ticks.control[0, FIELDS["applied"]]))
    assert result.ticks.truth[1] != pytest.approx(own, abs=1e-6)


def test_sinks_see_every_tick_and_what_fails_beside_the_loop_ends_the_run(
    reference: Reference, controller: TrackingController
) -> None:
    def run(sink: LoopSink) -> LoopResult:
        return Assembly(reference, LAB, REAL, law=controller).simulate(sink=sink)

    here, there = Kept(), Kept()
    result = run(here)
    with SinkBeside(there) as beside:
        run(beside)
    for name in ("times", "truth", "estimates", "control"):
        assert (here.whole(name) == getattr(result.ticks, name)).all()
        assert (here.whole(name) == there.whole(name)).all()
    assert here.kept == there.kept
    assert here.kept[-1] == result.end
    assert max(len(block.times) for block in here.blocks) <= 0.2 * REAL.rate

    class Fails(Kept):
        def event(self, event: Event) -> None:
            raise InputError("the disk is full")

    with pytest.raises(InputError, match="the disk is full"), SinkBeside(Fails()) as beside:
        run(beside)
