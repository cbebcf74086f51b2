"""Commissioning finds each mistake that a rig may have, by a true sentence with a remedy, and never does harm."""

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any

import casadi as ca
import numpy as np
import pytest
from shadowing_stand_in import LAB

from dpcontrol.dynamics.chain import ArmChainParameters, Level, equations_of
from dpcontrol.foundation.causes import FindingCause as Cause
from dpcontrol.loop.bench import MechanicsSettings
from dpcontrol.loop.loop import LoopSettings
from dpcontrol.loop.protocols import Reading
from dpcontrol.loop.result import Rig
from dpcontrol.plans.model import load_model
from dpcontrol.references.problem import Limits
from dpcontrol.rig.bench import BenchRecipe
from dpcontrol.rig.commissioning import Commissioning, Finding, Grade, commission
from dpcontrol.rig.fits import modes
from dpcontrol.rig.motions import REACH, CommissioningSettings

QUICK = CommissioningSettings(look=0.2, hold=0.5, sweep=4.0, ring=1.5, wait=3.0)
LIMITS = Limits(position=0.4)
RATE = 500.0


Spoil = Callable[[Reading], Reading]


class Watched:
    """A rig whose true cart and commands are remembered, and whose readings may be spoilt on their way."""

    truth: None = None

    def __init__(self, rig: Any, spoil: Spoil) -> None:
        self.rig, self.period, self.spoil = rig, rig.period, spoil
        self.plant = getattr(rig, "_rig", rig)
        self.breaks_at, self.error = -1, ArithmeticError
        self.farthest = self.strongest = 0.0
        self.ticks = self.stops = 0

    @property
    def fault(self) -> str:
        return self.rig.fault

    def read(self) -> Reading:
        self.ticks += 1
        if self.ticks == self.breaks_at:
            raise self.error("the bench caught fire")
        reading = self.rig.read()
        self.farthest = max(self.farthest, abs(float(self.plant.truth[-2])))
        return self.spoil(reading)

    def command(self, acceleration: float) -> None:
        assert not self.stops
        self.strongest = max(self.strongest, abs(acceleration))
        self.rig.command(acceleration)

    def stop(self) -> None:
        self.stops += 1
        self.rig.stop()


def bench(
    *faults: str, arms: ArmChainParameters = LAB, zeros: tuple[float, ...] = (), seed: int = 0,
    bent: float = 0.0, spoil: Spoil = lambda reading: reading, **changes: dict[str, Any],
) -> Watched:  # fmt: skip
    """Return a bench at hand; changes: of its sensors, drive and disturbances."""
    settings = LoopSettings(seed=seed, rate=RATE, mismatch=0.03)
    settings = replace(settings, **{part: replace(getattr(settings, part), **own) for part, own in changes.items()})
    n = arms.count
    start = np.concatenate([np.full(n, bent), np.zeros(n + 2)])
    recipe = BenchRecipe(arms, settings, LIMITS, start, 100_000, zeros=zeros, faults=faults)
    return Watched(recipe.rig(()), spoil)


def commissioned(
    rig: Rig, *, arms: ArmChainParameters = LAB, switches: float = 0.0, zeros: Sequence[float] = (),
    said: LoopSettings | None = None,
) -> Commissioning:  # fmt: skip
    said = said or LoopSettings(seed=0, rate=RATE)
    return commission(rig, arms, said, limits=LIMITS, zeros=zeros, switches=switches, options=QUICK)


def only_wrong(found: Commissioning, step: str, cause: Cause) -> Finding:
    """Return the one finding that is wrong, which is of this step and has a sentence and a remedy."""
    assert [(one.step, one.cause) for one in found.wrong] == [(step, cause)]
    assert all(one.sentence and (one.remedy or one.verdict is not Grade.WRONG) for one in found.findings)
    return found.wrong[0]


def test_a_rig_that_is_right_is_found_right_and_measured() -> None:
    rig = bench()
    found = commissioned(rig)
    assert not found.wrong
    assert [f.step for f in found.findings if f.verdict is Grade.UNSURE] == ["switches"]
    assert found.changes == {"delay": pytest.approx(1.0, abs=0.01), "lag": 0.0, "drive_lag": 0.0}
    assert rig.stops == 1


def test_an_arm_without_an_encoder_is_not_judged() -> None:
    found = commissioned(bench("encoder-2-reversed"), said=LoopSettings(seed=0, rate=RATE, encoders=(True, False)))
    assert not found.wrong
    figures = {finding.step: finding.figures for finding in found.findings}
    judged = [figures["still"]["zeros"], figures["counts"]["counts"], figures["play"]["play"]]
    assert [len(values) for values in judged] == [1, 1, 1]
    found = commissioned(bench("encoder-1-factor-4"), said=LoopSettings(seed=0, rate=RATE, encoders=(True, False)))
    only_wrong(found, "encoders", Cause.SCALE)


WIRED_WRONGLY = {
    "drive-reversed": ("drive", Cause.REVERSED, {}),
    "cart-reversed": ("drive", Cause.CART_REVERSED, {}),
    "encoder-1-reversed": ("encoders", Cause.REVERSED, {"arm": 1}),
    "encoders-swapped": ("encoders", Cause.SWAPPED, {"order": [2, 1]}),
    "angles-not-summed": ("encoders", Cause.NOT_SUMMED, {}),
    "encoder-1-factor-4": ("encoders", Cause.SCALE, {"arm": 1, "scale": 4.0}),
}


@pytest.mark.slow
@pytest.mark.parametrize("fault", WIRED_WRONGLY)
def test_wrong_wiring_is_detected_and_no_measurement_is_kept(fault: str) -> None:
    rig = bench(fault, seed=4, mechanics={"stiction": 0.002})
    found = commissioned(rig)
    step, cause, figures = WIRED_WRONGLY[fault]
    assert figures.items() <= only_wrong(found, step, cause).figures.items()
    assert not found.changes
    assert rig.farthest <= REACH + 1e-4
    assert rig.strongest <= LIMITS.acceleration


@pytest.mark.slow
def test_zeros_are_measured_though_the_arms_swing_and_then_taken_off() -> None:
    said = LoopSettings(seed=0, rate=RATE)
    rig = bench("zeros-off", bent=0.03)
    found = commissioned(rig)
    assert "zeros = [" in only_wrong(found, "still", Cause.DIFFERS).remedy
    assert found.changes["zeros"] == pytest.approx([0.03, -0.02], abs=1e-3)
    again = commissioned(bench(zeros=(0.03, -0.02)), zeros=found.changes["zeros"], said=said)
    assert not again.wrong
    assert again.changes["zeros"] == pytest.approx([0.03, -0.02], abs=1e-3)


@pytest.mark.slow
def test_a_tilted_track_is_named_beside_zeros_and_half_a_turn_is_no_zero() -> None:
    tilted = commissioned(bench(disturbances={"tilt": 0.02}))
    assert "level the track" in only_wrong(tilted, "still", Cause.DIFFERS).remedy
    found = commissioned(bench(zeros=(np.pi, np.pi)))
    only_wrong(found, "still", Cause.FAR)
    assert not found.changes


@pytest.mark.slow
def test_delay_and_lag_are_measured_and_compared_with_the_scene() -> None:
    delay, lag = 4.0, 0.02
    found = commissioned(bench(drive={"delay": delay, "lag": lag}))
    assert found.changes["delay"] == pytest.approx(delay, abs=0.02)
    assert found.changes["lag"] == pytest.approx(lag, abs=5e-5)
    assert f"set delay = {found.changes['delay']:g}" in only_wrong(found, "delay", Cause.DIFFERS).remedy


def times(*factors: float) -> Spoil:
    return lambda reading: reading._replace(positions=reading.positions * np.array(factors))


def noisy_cart(reading: Reading) -> Reading:
    noise = np.random.default_rng(round(1e4 * reading.time)).normal(0.0, 0.001)
    return reading._replace(positions=np.array([0.0, 0.0, noise]))


def in_degrees(reading: Reading) -> Reading:
    return reading._replace(positions=np.degrees(reading.positions) * [1, 1, np.pi / 180])


@pytest.mark.slow
@pytest.mark.parametrize(
    ("trouble", "step", "cause"),
    [
        ({"spoil": times(1, 1, 0.3)}, "drive", Cause.CART_SCALE),
        ({"spoil": times(1, 1, 1000)}, "drive", Cause.LEFT),
        ({"spoil": times(-1, -1, -1)}, "drive", Cause.REVERSED),
        ({"spoil": noisy_cart}, "drive", Cause.WANDERS),
        ({"spoil": lambda r: r._replace(positions=r.positions + 0.2)}, "still", Cause.OFF_CENTRE),
        ({"spoil": in_degrees}, "still", Cause.SWINGING),
        ({"drive": {"track": 0.5, "switch_margin": 0.5}}, "still", Cause.TOUCHED),
        ({"drive": {"response": 0.0}}, "drive", Cause.STANDS),
        ({"drive": {"response": 4.0}}, "drive", Cause.SCALE),
        ({"sensors": {"stuck_at": 0.0, "stuck_sensor": 2}}, "drive", Cause.DEAD),
        ({"sensors": {"stuck_at": 0.0, "stuck_sensor": 1}}, "encoders", Cause.STUCK),
        ({"bent": 0.5}, "still", Cause.SWINGING),
    ],
)
def test_each_failure_is_found_without_harm(trouble: dict[str, Any], step: str, cause: Cause) -> None:
    rig = bench(**trouble)
    found = commissioned(rig)
    only_wrong(found, step, cause)
    assert not found.changes
    assert rig.farthest <= REACH
    assert cause is not Cause.TOUCHED or rig.strongest == 0
    assert rig.stops == 1


def test_a_sensor_that_gives_no_numbers_is_named() -> None:
    rig = bench(spoil=lambda r: r._replace(present=np.array([True, r.time < 0.6, True])))
    assert commissioned(rig).wrong[0].figures["sensors"] == ["the encoder of arm 2"]
    assert rig.stops == 1


# The bench's joints slide at 0.8 of the break-away torque; play that is not in the fit moves the estimate.
FRICTION, WITH_PLAY = 0.15, 0.5
DRY = (0.0, 0.001, 0.002, 0.005)


@pytest.mark.slow  # Several seconds per bench.
@pytest.mark.parametrize("seed", range(2))
def test_no_healthy_encoder_is_called_wrong_whatever_the_dry_friction(seed: int) -> None:
    random = np.random.default_rng(seed)
    dry, counts = tuple(random.choice(DRY, size=2).tolist()), int(random.choice([2000, 4096, 40_000]))
    rig = bench(mechanics={"stiction": dry}, sensors={"counts": counts}, seed=seed)
    said = LoopSettings(seed=0, rate=RATE)
    found = commissioned(rig, said=replace(said, sensors=replace(said.sensors, counts=counts)))
    assert not found.wrong
    assert set(found.changes) == {"delay", "lag", "drive_lag"}
    by_step = {f.step: f for f in found.findings}
    assert by_step["friction"].figures["torques"] == pytest.approx(0.8 * np.array(dry), rel=FRICTION, abs=1e-4)
    assert by_step["encoders"].figures["factors"] == pytest.approx([1, 1], abs=0.2)


@pytest.mark.slow
@pytest.mark.parametrize(("play", "seed"), [((0.0043, 0.0127), 5), ((0.0152, 0.0), 6)])
def test_the_play_of_each_encoder_is_measured(play: tuple[float, float], seed: int) -> None:
    rig = bench(mechanics={"play": play}, drive={"lag": 0.006, "command_noise": 0.1}, seed=seed)
    found = commissioned(rig)
    finding = next(f for f in found.findings if f.step == "play")
    assert finding.verdict is Grade.WRONG
    assert finding.cause is Cause.DIFFERS
    assert found.changes["play"] == pytest.approx(play, rel=0.15, abs=1e-3)
    assert [value == 0 for value in found.changes["play"]] == [value == 0 for value in play]
    # With this setting, the rig agrees with [run].
    said = LoopSettings(seed=0, rate=RATE, mechanics=MechanicsSettings(play=tuple(found.changes["play"])))
    rig = bench(mechanics={"play": play}, seed=seed + 10)
    assert next(f for f in commissioned(rig, said=said).findings if f.step == "play").verdict is Grade.OK


@pytest.mark.slow
@pytest.mark.parametrize(("torque", "play", "seed"), [(0.0007, 0.0, 3), (0.0013, 0.006, 4)])
def test_dry_friction_is_measured_in_each_joint(torque: float, play: float, seed: int) -> None:
    rig = bench(mechanics={"stiction": torque, "kinetic": 1.0, "play": play}, drive={"lag": 0.004}, seed=seed)
    finding = next(f for f in commissioned(rig).findings if f.step == "friction")
    assert finding.verdict is Grade.UNSURE
    assert finding.figures["torques"] == pytest.approx([torque, torque], rel=WITH_PLAY if play else FRICTION)


def with_switches(*faults: str, track: float = 0.5) -> Watched:
    return bench(*faults, drive={"track": track, "switch_margin": 0.05})


@pytest.mark.slow
def test_both_switches_are_found_by_creeping_and_the_cart_comes_back() -> None:
    rig = with_switches()
    found = commissioned(rig, switches=0.48)
    assert not found.wrong
    sides = [f.figures for f in found.findings if f.step == "switches"]
    assert [(one["side"], one["answer"]) for one in sides] == [("right", 1), ("left", -1)]
    assert [one["position"] for one in sides] == pytest.approx([0.45, -0.45], abs=1e-3)
    assert rig.farthest < 0.455
    assert abs(float(rig.plant.truth[-2])) < 1e-3


@pytest.mark.slow
@pytest.mark.parametrize(
    ("faults", "track", "cause"),
    [
        (("switch-dead",), 0.5, Cause.SILENT),
        (("switches-swapped",), 0.5, Cause.OTHER),
        ((), 0.4, Cause.WITHIN),
    ],
)
def test_a_switch_that_is_dead_exchanged_or_in_the_way_is_found(
    faults: tuple[str, ...], track: float, cause: Cause
) -> None:
    found = commissioned(with_switches(*faults, track=track), switches=0.48)
    assert {(f.step, f.cause) for f in found.wrong} == {("switches", cause)}
    assert not found.changes


@pytest.mark.slow
def test_a_hard_stop_in_the_way_to_a_switch_ends_it_by_name() -> None:
    assert "hard stop" in only_wrong(commissioned(bench(), switches=0.48), "switches", Cause.FAULT).sentence


@pytest.mark.parametrize("tick", [1, 700])
def test_a_rig_that_fails_is_stopped_and_quoted_and_an_interrupt_stops_it_too(tick: int) -> None:
    rig = bench()
    rig.breaks_at = tick
    found = commissioned(rig)
    assert "the bench caught fire" in found.blocking[0].sentence
    assert not found.changes
    assert rig.stops == 1
    rig = bench()
    rig.breaks_at, rig.error = tick, KeyboardInterrupt
    with pytest.raises(KeyboardInterrupt):
        commissioned(rig)
    assert rig.stops == 1


def test_readings_that_stay_out_stop_the_cart() -> None:
    rig = bench(sensors={"dropout": 0.999})
    only_wrong(replace(found := commissioned(rig), findings=found.findings[:-1]), "still", Cause.UNREAD)
    assert rig.stops == 1


@pytest.mark.slow
@pytest.mark.parametrize("model", ["single", "triple"])
def test_other_numbers_of_arms_are_commissioned_as_well(model: str) -> None:
    arms = load_model(model).arms
    assert not commissioned(bench(arms=arms), arms=arms).wrong
    found = commissioned(bench("encoder-1-reversed", arms=arms), arms=arms)
    only_wrong(found, "encoders", Cause.REVERSED)


def test_modes_are_those_of_the_equations_linearised() -> None:
    equations = equations_of(LAB, Level.CART)
    function = ca.Function("f", [equations.state, equations.inputs, equations.parameters], [
        ca.jacobian(equations.rate, equations.state), ca.jacobian(equations.rate, equations.inputs)])  # fmt: skip
    slopes, push = (np.array(part) for part in function(np.zeros(6), 0.0, LAB.base()))
    found = modes(LAB)
    poles = np.linalg.eigvals(slopes[:4, :4])
    ours = found.frequencies * (-found.dampings + 1j * np.sqrt(1 - found.dampings**2))
    assert sorted(poles[poles.imag > 0].imag) == pytest.approx(sorted(ours.imag), rel=1e-4)
    # At once after a push all of it is acceleration: θ̈ = W_0 ÿ = -W_0 · 1.
    assert -found.shapes.sum(axis=1) == pytest.approx(push[2:4, 0])
