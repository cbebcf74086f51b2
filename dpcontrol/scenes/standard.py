"""The robustness score: how much of each kind of trouble a controller stands, level by level.

Each kind is raised in 21 equal levels from none to its worst. The score of a kind is the share of its runs that
complete the whole itinerary, and the score of the controller the mean over the kinds. The first six kinds and their 21
levels follow the leaderboard of the dfki double pendulum; model error, noise and pushes are as wide as there, delay
and response are scaled to this loop. The last three are of encoders and of the cart's drive.

Source: Wiebe et al., Open-source dual-purpose acrobot and pendubot platform (IEEE RAM, 2024), section on benchmarking.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from dpcontrol.lab.statistics import Share, wilson
from dpcontrol.scenes.campaign import CaseResult, cases_of
from dpcontrol.scenes.campaign_jobs import Case
from dpcontrol.scenes.itinerary import Itinerary

LEVELS = 21


@dataclass(frozen=True)
class Trouble:
    """One kind: the run setting it raises, from `least` to `worst`, and others that go with it."""

    name: str
    setting: str
    least: float
    worst: float
    besides: tuple[tuple[str, float], ...] = ()
    integer: bool = False

    def level(self, k: int) -> dict[str, float]:
        """Return the settings at level k of 0 … 20."""
        value = self.least + (self.worst - self.least) * k / (LEVELS - 1)
        return {self.setting: round(value) if self.integer else value, **dict(self.besides)}


STANDARD = (
    Trouble("model error", "mismatch", 0.0, 0.25),
    Trouble("velocity noise", "rate_noise", 0.0, 0.5),
    Trouble("command noise", "command_noise", 0.0, 5.0),
    Trouble("response", "response", 1.0, 0.5),
    Trouble("delay", "delay", 1.0, 41.0),
    Trouble("pushes", "push_impulse", 0.0, 0.004, (("pushes", 3.0),)),
    Trouble("quantisation", "counts", 40_000, 64, integer=True),
    Trouble("acceleration limit", "acceleration", 30.0, 1.0),
    Trouble("encoder zeros", "zero_error", 0.0, 0.05),
)
"""Nine kinds; SI units, delay in periods, encoders in counts per turn."""


def standard_cases(itinerary: Itinerary, *, fixed: Mapping[str, Any], controllers: Sequence[str]) -> tuple[Case, ...]:
    """Return the cases of every controller, kind and level, on top of the overrides in `fixed`.

    Raises:
        InputError: an unknown controller or override.
    """
    cases = []
    for controller in controllers:
        for kind in STANDARD:
            for k in range(LEVELS):
                values = {**fixed, "controller": controller, **kind.level(k)}
                (case,) = cases_of(itinerary, fixed=values, over={})
                label = f"{controller}, {kind.name} {k} of {LEVELS - 1}"
                named = (("controller", controller), ("kind", kind.name), ("level", float(k)))
                cases.append(Case(label, named, case.loop))
    return tuple(cases)


@dataclass(frozen=True)
class StandardScore:
    """One controller's shares of completed runs by kind, and their mean, 0 to 1."""

    controller: str
    kinds: Mapping[str, Share]
    total: float


def standard_scores(results: Sequence[CaseResult]) -> tuple[StandardScore, ...]:
    """Return each controller's score from the results of `standard_cases`."""
    counts: dict[str, dict[str, list[int]]] = {}
    for result in results:
        values = dict(result.case.values)
        sums = counts.setdefault(str(values["controller"]), {}).setdefault(str(values["kind"]), [0, 0])
        sums[0] += result.completed.successes
        sums[1] += result.completed.runs
    scores = []
    for controller, kinds in counts.items():
        shares = {name: wilson(*pair) for name, pair in kinds.items()}
        scores.append(StandardScore(controller, shares, sum(s.rate for s in shares.values()) / len(shares)))
    return tuple(scores)
