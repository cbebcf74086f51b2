"""What pulses can do against an orbit's unstable direction, and the orbit, encoders and filter OGY's borders are for.

An error grows by Λ_j, about λ^(1/k), from one of k sections to the next. Along the unstable direction w_j,

    ν_{j+1} = Λ_j ν_j + β_j p_j,    |p_j| ≤ limit:      |ν_j| ≤ c_j limit,    c_j = (c_{j+1} + |β_j|) / Λ_j

can still be brought back, nothing larger. A flight from there departs from its linear map by about κ_j (c_j limit)²:
where that is more than c_{j+1} limit, nothing linear tells what becomes of it.

Source: Ott, Grebogi & Yorke, Controlling chaos, Physical Review Letters 64 (1990), 1196, for noise against the largest
pulse; Hu & Lin, Control Systems with Actuator Saturation (2001), chapter 2, for c.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from dpcontrol.control.estimator_settings import EkfSettings
from dpcontrol.control.model import SampledModel
from dpcontrol.control.ogy import OgyController, OgySettings, ogy_controller
from dpcontrol.dynamics.chain import ArmChainParameters
from dpcontrol.loop.bench import SensorSettings
from dpcontrol.loop.loop import sampled_model
from dpcontrol.orbits.lyapunov import lyapunov_orbit
from dpcontrol.references.sustained import SectionMap, SustainedOrbit, sustained_orbit
from dpcontrol.scenes.model import load_model

Array = NDArray[np.float64]

RATE = 1000.0
SECONDS = 6.0
LIMIT = 0.5
"""m/s²: small, so that authority ends before the linear range does."""
ESTIMATOR = EkfSettings(augment=())
"""As the shipped itineraries keep orbits; zeros being estimated would ask for a third more of the pulses at k = 16."""
_SETTLE = 40
_PROBE = 0.25
"""Of what pulses of LIMIT can bring back: from where flights are compared with their linear maps."""


@dataclass(frozen=True, eq=False)
class Task:
    """An orbit to be held for `seconds`, the arms that are believed and simulated alike, and their model."""

    orbit: SustainedOrbit
    arms: ArmChainParameters
    model: SampledModel
    seconds: float = SECONDS

    def controller(self, sections: int, limit: float = LIMIT) -> OgyController:
        """Return the law by `sections` pulses a period, of at most `limit` m/s²; it learns nothing."""
        settings = OgySettings(sections=sections, pulse_limit=limit, parameter_error=0.0)
        return ogy_controller(self.orbit, self.model, settings, seconds=self.seconds)


def task(saddle: str = "down-up", energy: float = -0.07) -> Task:
    """Return the lab's orbit about a saddle at an energy in J."""
    model = load_model("lab")
    orbit = sustained_orbit(lyapunov_orbit(model.system, saddle, energy=energy), model.arms)
    return Task(orbit, model.arms, sampled_model(model.arms, RATE))


def encoders(counts: float) -> SensorSettings:
    """Return encoders of so many counts per turn, their zeros anywhere within a count; the cart's is fine."""
    whole = max(round(counts), 1)
    return SensorSettings(counts=whole, cart_resolution=1e-6, zero_error=np.pi / whole)


@dataclass(frozen=True, eq=False)
class Sections:
    """An orbit's k sections to first order: their maps, and along the unstable direction what grows and what pulses do.

    growths Λ (k,), reaches β (k,) for 1 m/s², directions w (k, N) of unit length; ranges c (k,): what pulses of
    1 m/s² can bring back.
    """

    task: Task
    maps: tuple[SectionMap, ...]
    growths: Array
    reaches: Array
    directions: Array

    @cached_property
    def ranges(self) -> Array:
        """Return c (k,)."""
        out, ahead = np.zeros(len(self.maps)), 0.0
        for j in reversed(list(range(len(out))) * _SETTLE):
            ahead = (ahead + abs(self.reaches[j])) / self.growths[j]
            out[j] = ahead
        return out

    @cached_property
    def largest_linear_pulse(self) -> float:
        """Return the limit of the pulses, m/s², up to which flights between the sections are linear.

        There κ_j (c_j limit)² is c_{j+1} limit, at the section where this comes first.
        """
        begins = self._unstable_states()
        size = _PROBE * LIMIT * self.ranges
        least = np.inf
        for j, onward in enumerate(np.roll(self.ranges, -1)):
            ends = [self._flown(j, sign * size[j] * begins[j]) for sign in (-1.0, 0.0, 1.0)]
            if not np.isfinite(ends).all():
                return 0.0
            bent = abs(ends[0] + ends[2] - 2 * ends[1]) / 2 / size[j] ** 2
            least = min(least, float(onward / (bent * self.ranges[j] ** 2)))
        return least

    def _unstable_states(self) -> Array:
        """Return states (k, N) on the sections, from which only the unstable direction grows, with w · state = 1."""
        values, right = np.linalg.eig(_round(self.maps))
        x = np.real(right[:, np.argmax(np.abs(values))])
        out = []
        for one, w in zip(self.maps, self.directions, strict=True):
            out.append(x / (w @ x))
            x = one.matrix @ out[-1]
        return np.array(out)

    def _flown(self, j: int, away: Array) -> float:
        """Return ν where the model crosses the next section, begun off section j by `away` (N,), without a pulse.

        Not a number where it does not come there in half a flight more.
        """
        one, model, orbit = self.maps[j], self.task.model, self.task.orbit
        ticks = int(1.5 * one.duration / model.period)
        inputs = orbit.input(one.start.time + (np.arange(ticks) + 0.5) * model.period)
        x, end = one.start.state + away, one.end
        late = float(end.lateness(x))
        for i, u in enumerate(inputs.tolist()):
            following = model.step(x, u)
            after = float(end.lateness(following))
            if 2 * (i + 1) * model.period > one.duration and late < 0.0 <= after:
                crossing = x + (following - x) * late / (late - after)
                return float(self.directions[(j + 1) % len(self.maps)] @ (crossing - end.state))
            x, late = following, after
        return float("nan")


def sections_of(one: Task, count: int) -> Sections:
    """Return the orbit's sections: w_{j+1} A_j = Λ_j w_j, β_j = w_{j+1} · B_j."""
    maps = one.orbit.section_maps(count)
    values, left = np.linalg.eig(_round(maps).T)
    w = np.real(left[:, np.argmax(np.abs(values))])
    directions, growths, reaches = np.zeros((count, len(w))), np.zeros(count), np.zeros(count)
    w = w / np.linalg.norm(w)
    for j in reversed(range(count)):
        before = w @ maps[j].matrix
        growths[j], reaches[j] = np.linalg.norm(before), w @ maps[j].response
        w = before / growths[j]
        directions[j] = w
    return Sections(one, maps, growths, reaches, directions)


def _round(maps: Sequence[SectionMap]) -> Array:
    """Return the linear map (N, N) once round the orbit, from its first section back to it."""
    product = np.eye(len(maps[0].response))
    for one in maps:
        product = one.matrix @ product
    return product
