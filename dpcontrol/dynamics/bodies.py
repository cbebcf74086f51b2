"""Whether arms can be of a bench: what is odd about their parameters, and what no bench has.

An arm of mass m and length l with its centre a from the joint, between joint and end, has an inertia about its centre
of at most m a (l - a), all its mass at both ends, and of zero only as a point mass, which belongs at a rod's end. It
swings if its friction leaves gravity's torque room: with I about the joint and the largest torque G of its weight and
of what hangs on it, a viscous coefficient beyond 2 √(G I) lets it creep down without a swing, Coulomb friction beyond G
holds it anywhere, and the drag b λ v², λ = I/S, beyond G brakes it before it reaches the speed of a fall, v² = 4 g λ.
"""

from collections.abc import Iterator

import numpy as np

from dpcontrol.dynamics.chain import ArmChainParameters
from dpcontrol.foundation.errors import InputError

_BEYOND = 10.0
"""Lengths of the arm at which its centre can only be a slip, as of mm for m."""
_HEAVIEST = 100.0
"""The same of an inertia over m l²: g cm² for kg m², say."""
_STUCK = 1000.0
"""The same of friction over what leaves no swing."""
_HOLLOW = 0.02
"""Share of the largest inertia m a (l - a) that all bodies have but point masses; shipped models have 0.04 and more."""
_AT_THE_END = 0.95
"""Share of the length from which on a centre is that of a mass at the rod's end."""


def oddities(arms: ArmChainParameters) -> tuple[str, ...]:
    """Return a sentence on each parameter that is odd for an arm, beginning with its name; none for a usual bench.

    Raises:
        InputError: a parameter is beyond any bench.
    """
    return tuple(sentence for arm in range(arms.count) for sentence in (*_body(arms, arm), *_friction(arms, arm)))


def _body(arms: ArmChainParameters, arm: int) -> Iterator[str]:
    mass, centre, length, inertia = (
        getattr(arms, name)[arm] for name in ("mass", "centre_of_mass", "length", "inertia")
    )
    of = f"of arm {arm + 1}"
    if centre > length * (1 + 1e-9):
        times = f"{centre / length:.3g} times its length of {length:g} m"
        text = f"centre_of_mass = {centre:g} m {of} is {times} from its joint"
        if centre > _BEYOND * length:
            raise InputError(f"{text}; give both in metres, the centre from the arm's joint")
        yield f"{text}, beyond its end; is that meant?"
    farthest = max(centre, length)
    if inertia > mass * farthest**2:
        away = np.sqrt(inertia / mass)
        text = (
            f"inertia = {inertia:g} kg m² {of} puts its mass of {mass:g} kg {away:.3g} m from its centre in the mean, "
            f"and the arm is {length:g} m long"
        )
        if inertia > _HEAVIEST * mass * farthest**2:
            raise InputError(f"{text}; give it in kg m², about the centre of mass")
        yield f"{text}; is that meant, about the centre of mass?"
    largest = mass * centre * (length - centre)
    if centre < _AT_THE_END * length and inertia < _HOLLOW * largest:
        yield (
            f"inertia = {inertia:g} kg m² {of} is that of a point mass {centre:g} m along a weightless rod of "
            f"{length:g} m; a uniform rod of {mass:g} kg has {mass * length**2 / 12:.3g} kg m², and with this centre "
            f"at most {largest:.3g} fits between joint and end; is a point mass meant?"
        )


def _friction(arms: ArmChainParameters, arm: int) -> Iterator[str]:
    count, base = arms.count, arms.base()
    about_joint = base[np.cumsum([0, *range(count, 1, -1)])[arm]]
    weight, coupling = base[count * (count + 1) // 2 :].reshape(-1)[[arm, count + arm]]
    reach = about_joint / coupling
    torque = f"gravity's torque on it of at most {weight:.3g} N m"
    laws = {
        "viscous": (2 * np.sqrt(weight * about_joint), "N m s/rad", lambda k: (
            f"lets it creep, not swing: {torque} turns it at {weight / k:.2g} rad/s at the fastest")),
        "coulomb": (weight, "N m", lambda _: f"holds it wherever it is, against {torque}"),
        "quadratic": (weight / (4 * arms.gravity * reach**2), "N s²/m²", lambda b: (
            f"brakes it: {torque} moves it at {np.sqrt(weight / (b * reach)):.2g} m/s at the fastest")),
    }  # fmt: skip
    for law, (most, unit, effect) in laws.items():
        values = getattr(arms, law)
        if values and values[arm] > most:
            value = values[arm]
            text = f"{law} = {value:g} {unit} of arm {arm + 1} {effect(value)}"
            if value > _STUCK * most:
                raise InputError(f"{text}; no bench is like that: give it in {unit}")
            yield f"{text}; is that meant?"
