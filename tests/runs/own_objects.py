"""Laws, an estimator, a plant and a rig as a user would write them."""

import numpy as np

import dpcontrol as dp
from dpcontrol.control.ekf import CompiledEkf
from dpcontrol.control.estimator_settings import EkfSettings
from dpcontrol.control.interface import sampled_model
from dpcontrol.loop.assembly import Assembly
from dpcontrol.loop.bench import SensorSettings
from dpcontrol.plans.model import load_model

LAB = load_model("lab").arms
NOISE = SensorSettings().covariance(2)


class Gains:
    """The gains of "tvlqr" on the outer turn, looked up by time."""

    def __init__(self) -> None:
        plan = dp.plan("outer-turn")
        scene = plan.itinerary.with_run({"controller": "tvlqr"})
        self.gains = Assembly(plan.reference, LAB, scene.loop).controller.gains
        self.asked, self.resets = 0, 0

    def reset(self) -> None:
        self.resets += 1

    def control(self, time, state, reference) -> float:
        self.asked += 1
        gain = self.gains[min(round(1000 * time), len(self.gains) - 1)]
        return reference.feedforward + float(gain @ (reference.state - state))


class Filter:
    """An extended Kalman filter of the state alone; the drive's delay is one period."""

    def __init__(self) -> None:
        self.filter = CompiledEkf(sampled_model(LAB, 1000.0), EkfSettings(augment=()), noise=NOISE)
        self.first = dp.plan("outer-turn").reference.state(0.0)

    def reset(self) -> None:
        self.estimate, self.on_its_way = None, 0.0

    def update(self, reading, acceleration):
        if self.estimate is None:
            self.estimate = self.filter.update(self.filter.first(self.first), reading.positions)
        else:
            self.estimate = self.filter.step(self.estimate, self.on_its_way, reading.positions)
        self.on_its_way = acceleration
        return self.estimate.state


class Judged(Filter):
    """The same with its standard deviations."""

    estimate = None

    @property
    def sigmas(self):
        return np.ones(6) if self.estimate is None else self.estimate.sigmas


class Arms:
    """The lab's arms by Runge-Kutta steps."""

    def __init__(self) -> None:
        self.models = {}

    def step(self, state, acceleration, seconds):
        model = self.models.setdefault(seconds, sampled_model(LAB, 1 / seconds))
        return model.step(state, acceleration)


class Rig:
    """The same arms behind their encoders: a command acts in the period after the next reading."""

    def __init__(self) -> None:
        self.model, self.state = sampled_model(LAB, 1000.0), dp.plan("outer-turn").reference.state(0.0)
        self.on_its_way, self.acting, self.count, self.stopped = 0.0, 0.0, 0, 0

    @property
    def truth(self):
        return self.state

    def read(self):
        if self.count:
            self.state = self.model.step(self.state, self.acting)
            self.acting = self.on_its_way
        self.count += 1
        return self.state[[0, 1, 4]]

    def command(self, acceleration: float) -> None:
        self.on_its_way = acceleration

    def stop(self) -> None:
        self.stopped += 1


class Mute:
    """No law at all."""


class Wrong(Gains):
    """A law that ends after a tenth of a second."""

    def control(self, time, state, reference) -> float:
        return float("nan") if time >= 0.1 else super().control(time, state, reference)
