"""Settings of a rig's mechanics: bounds, messages, files, what the loop knows of them."""

from dataclasses import replace

import numpy as np
import pytest
from shadowing_stand_in import LAB

from dpcontrol.control.tick import KnownMechanics
from dpcontrol.loop.bench import BenchSettings, MechanicsSettings, draw_bench
from dpcontrol.loop.loop import LoopSettings
from dpcontrol.loop.simulated import SimulatedRig
from dpcontrol.references.problem import Limits

LIMITS = Limits(position=0.4, velocity=3.0, acceleration=30.0)


def test_the_loop_models_the_true_play_and_belt_by_default() -> None:
    settings = LoopSettings(seed=0, mechanics=MechanicsSettings(play=0.01, belt=20.0, belt_damping=0.1))
    known = settings.known_mechanics(2)
    assert known == KnownMechanics((0.01, 0.01), 20.0, 0.1)
    assert settings.known_lag == pytest.approx(2 * 0.9 / (40 * np.pi))
    unaware = replace(settings, mechanics=replace(settings.mechanics, known_play=0.0, known_belt=0.0))
    assert unaware.known_mechanics(2) == KnownMechanics((0.0, 0.0), 0.0, 0.1)
    assert unaware.known_lag == 0.0
    # A loop at 50 Hz cannot shape for 20 Hz.
    assert replace(settings, rate=50.0).known_mechanics(2).belt == 0.0


def test_the_notch_passes_slow_commands_and_takes_out_those_at_the_belts_frequency() -> None:
    period, known = 1e-3, KnownMechanics((), 20.0, 0.0)
    b0, b1, b2, a1, a2 = known.notch(period)
    for frequency, gain in ((0.0, 1.0), (20.0, 0.0)):
        z = np.exp(2j * np.pi * frequency * period)
        assert abs((b0 + b1 / z + b2 / z**2) / (1 + a1 / z + a2 / z**2)) == pytest.approx(gain, abs=1e-9)


def test_first_rates_and_the_carts_place_are_those_of_the_start() -> None:
    settings = BenchSettings(mechanics=MechanicsSettings(initial_rate=0.5, initial_cart=-0.07))
    draws = [draw_bench(LAB, settings, seed=seed, ticks=10, period=1e-3) for seed in range(200)]
    rates = np.array([SimulatedRig(d, settings, limits=LIMITS, start=np.zeros(6)).truth.copy() for d in draws])
    assert np.all(rates[:, 4] == -0.07)
    assert np.abs(rates[:, 2:4]).max() <= 0.5
    assert np.std(rates[:, 2:4], axis=0) == pytest.approx(np.full(2, 0.5 / np.sqrt(3)), rel=0.15)


@pytest.mark.parametrize("scale", ["motor", "cart"])
def test_the_scale_reads_the_motor_or_the_cart_and_the_truth_is_the_cart(scale: str) -> None:
    settings = BenchSettings(mechanics=MechanicsSettings(belt=10.0, belt_scale=scale))
    draw = draw_bench(LAB, settings, seed=1, ticks=200, period=1e-3)
    rig = SimulatedRig(draw, settings, limits=LIMITS, start=np.zeros(6))
    apart = 0.0
    for k in range(150):
        reading = rig.read()
        rig.command(5.0 if k < 50 else -5.0)
        place = {"motor": rig.state[6], "cart": rig.truth[4]}[scale]
        assert reading.positions[2] == pytest.approx(place, abs=1e-6)
        apart = max(apart, abs(rig.state[6] - rig.truth[4]))
    assert apart > 1e-3
