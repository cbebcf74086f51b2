"""The robustness score: how much of each kind of trouble a controller stands, level by level.

Each kind has 21 levels, on top of what the scene itself asks of its bench. The score of a kind is the share of its runs
that complete the whole itinerary, symbol by symbol, by the true state; that of the controller the mean over the kinds.

The first six kinds are those of the leaderboard of the dfki double pendulum, which swings up under a torque of at most
6 N m; the last three are of encoders and of the cart's drive. What agrees with theirs, and what does not:

    velocity noise   the same: Gaussian, 0 to 0.5 rad/s, on the rates that the controller is given
    response         the same: 0.1 to 2 times what was commanded
    delay            the same lengths, 0 to 40 ms; here the loop knows it and predicts, as a rig's delay is known
    model error      there one parameter at a time, ±25 %; here all at once, ±25 % at worst and friction five times that
    command noise    there up to 1.1 of 6 N m; here the same share of 30 m/s²
    pushes           there three a joint, of 0.06 to 1.3 N m s over a tenth of a second on arms several times as heavy,
                     at one level; here three in all, instantaneous, up to 0.004 N m s, 1.4 rad/s of the outer arm alone

There a level of noise counts if more than half of its runs succeed; here every run counts. So scores of the two may be
read side by side, kind by kind, and not subtracted.

Source: Wiebe et al., Open-source dual-purpose acrobot and pendubot platform (IEEE RAM, 2024), section on benchmarking;
ranges as in the leaderboard's scripts, robustness version 2, of github.com/dfki-ric-underactuated-lab/double_pendulum.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from dpcontrol.foundation.statistics import Share, wilson
from dpcontrol.scenes.campaign import Case, CaseResult, cases_of, share_document
from dpcontrol.scenes.itinerary import Itinerary
from dpcontrol.scenes.run_options import RunOptions

LEVELS = 21


@dataclass(frozen=True)
class Trouble:
    """One kind: the run setting it raises, its values level by level, and other settings that go with it.

    in_periods: the values are in s, the setting in periods.
    """

    name: str
    setting: str
    values: tuple[float, ...]
    besides: tuple[tuple[str, float], ...] = ()
    in_periods: bool = False

    def level(self, k: int, *, rate: float) -> dict[str, float]:
        """Return the settings at level k of 0 … 20 of a loop at `rate` Hz."""
        value = self.values[k] * rate if self.in_periods else self.values[k]
        return {self.setting: value, **dict(self.besides)}


def _evenly(first: float, last: float) -> tuple[float, ...]:
    return tuple(np.linspace(first, last, LEVELS).tolist())


def _by_ratio(first: float, last: float) -> tuple[float, ...]:
    return tuple(np.geomspace(first, last, LEVELS).tolist())


STANDARD = (
    Trouble("model error", "mismatch", _evenly(0.0, 0.25)),
    Trouble("velocity noise", "rate_noise", _evenly(0.0, 0.5)),
    Trouble("command noise", "command_noise", _evenly(0.0, 5.5)),
    Trouble("response", "response", _evenly(0.1, 2.0)),
    Trouble("delay", "delay", _evenly(0.0, 0.04), in_periods=True),
    Trouble("pushes", "push_impulse", _evenly(0.0, 0.004), (("pushes", 3),)),
    Trouble("quantisation", "counts", tuple(round(v) for v in _by_ratio(40_000, 64))),
    Trouble("acceleration limit", "acceleration", _by_ratio(30.0, 0.3)),
    Trouble("encoder zeros", "zero_error", _evenly(0.0, 0.05)),
)
"""Nine kinds; SI units, encoders in counts per turn."""


def standard_cases(itinerary: Itinerary, *, fixed: RunOptions, controllers: Sequence[str]) -> tuple[Case, ...]:
    """Return the cases of every controller, kind and level, on top of `fixed`.

    Raises:
        InputError: an unknown controller.
    """
    cases = []
    for controller in controllers:
        for kind in STANDARD:
            for k in range(LEVELS):
                level = {"controller": controller, **kind.level(k, rate=itinerary.loop.rate)}
                (case,) = cases_of(itinerary, fixed=fixed.over(level), over={})
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

    def document(self) -> dict[str, Any]:
        """Return its part of what `dpcontrol campaign --standard --json` prints."""
        kinds = {kind: share_document(share) for kind, share in self.kinds.items()}
        return {"controller": self.controller, "score": self.total, "kinds": kinds}


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
