"""What free swings identify of a chain of arms: base parameters over one of them, and arms that have given ones.

On a cart that is clamped, or driven in acceleration, the equations stay the same when masses, inertias and friction all
grow in proportion. What can be identified are, with g known, over C = M_12 (M_11 of a single arm),

    M_ii/C, G_i/C,  l_2 … l_{n-1} (three arms and more),  viscous_i/C, coulomb_i/C, quadratic_i/C

since M_ij = l_i G_j/g for i < j and l_1 = g C/G_2. Of the many arms with the same ratios `nearest_arms` gives those
whose masses, centres, lengths and inertias differ least from given ones, in the sum of squared logarithms.

Source: Gautier, Khalil, Direct calculation of minimum set of inertial parameters of serial robots (1990).

How well identified arms are known, and arms drawn as likely as that says.

    r' = r + s Σ^½ z,      z standard normal,      arms' = the nearest to the model's with the ratios r'

r: the f ratios of `dpcontrol.dynamics.ratios`; Σ their covariance; s a factor on their standard errors.

Source: Hastie, Tibshirani, Friedman, The elements of statistical learning (2009), section 8.2 (parametric bootstrap).
"""

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dpcontrol.dynamics.chain import ArmChainParameters, Friction
from dpcontrol.foundation.errors import GoalMissed, InputError

Array = NDArray[np.float64]

_STEPS = 100
_CLOSE = 1e-13


def unit_name(count: int) -> str:
    """Return the base parameter over which the others are taken."""
    return "M12" if count > 1 else "M11"


def ratio_names(arms: ArmChainParameters) -> tuple[str, ...]:
    """Return the names of `base_ratios`, in order; those of friction begin with their law."""
    n, unit = arms.count, unit_name(arms.count)
    inertial = [f"M{i}{i}/{unit}" for i in range(1, n + 1) if n > 1] + [f"G{i}/{unit}" for i in range(1, n + 1)]
    lengths = [f"l{i}" for i in range(2, n)]
    return (*inertial, *lengths, *(f"{law}_{i}/{unit}" for law in ("viscous", *arms.friction) for i in range(1, n + 1)))


def inertial_count(count: int) -> int:
    """Return how many of the ratios are not friction: all but the smallest chain's 3n-2."""
    return 3 * count - 2


def base_ratios(arms: ArmChainParameters) -> Array:
    """Return the ratios (m,) that swings on a clamped or driven cart identify, in SI units."""
    n = arms.count
    base = arms.base()
    pairs = [(i, j) for i in range(n) for j in range(i, n)]
    inertia = {pair: base[k] for k, pair in enumerate(pairs)}
    weights = base[len(pairs) : len(pairs) + n]
    unit = inertia[0, 1] if n > 1 else inertia[0, 0]
    diagonal = [inertia[i, i] / unit for i in range(n) if n > 1]
    friction = [value / unit for law in ("viscous", *arms.friction) for value in getattr(arms, law)]
    return np.array([*diagonal, *(weights / unit), *arms.length[1 : n - 1], *friction])


def base_from_ratios(ratios: Any, arms: ArmChainParameters) -> list[Any]:
    """Return the base parameters with C = 1 as a list, in the arithmetic of `ratios` (numbers or symbols).

    The chain's gravity, its laws of friction and their smoothing rate are those of `arms`.
    """
    n = arms.count
    given = [ratios[k] for k in range(len(ratio_names(arms)))]
    diagonal, rest = (given[:n], given[n:]) if n > 1 else ([1.0], given)
    weights, rest = rest[:n], rest[n:]
    coupling = [weight / arms.gravity for weight in weights]
    lengths, friction = rest[: max(n - 2, 0)], rest[max(n - 2, 0) :]
    if n > 1:
        lengths = [1.0 / coupling[1], *lengths]
    inertia = [diagonal[i] if i == j else coupling[j] * lengths[i] for i in range(n) for j in range(i, n)]
    return [*inertia, *weights, *coupling, *friction, *([arms.smoothing] if arms.friction else [])]


def nearest_arms(ratios: Array, start: ArmChainParameters) -> ArmChainParameters:
    """Return the arms with these ratios (m,), of `start`'s laws of friction, that are nearest to `start`.

    Friction below zero becomes zero. An inertia of zero stays zero; gravity and the last length stay as they are.

    Raises:
        GoalMissed: there are no such arms near, as when a ratio is not positive.
    """
    n, count = start.count, inertial_count(start.count)
    wanted = np.asarray(ratios, dtype=float)[:count]
    columns = {"mass": n, "centre_of_mass": n, "length": n - 1, "inertia": n}
    first = np.concatenate([np.asarray(getattr(start, name))[:size] for name, size in columns.items()])
    free = first > 0

    def arms_at(logs: Array) -> ArmChainParameters:
        values = first.copy()
        values[free] *= np.exp(logs)
        parts = dict(zip(columns, np.split(values, np.cumsum(list(columns.values()))[:-1]), strict=True))
        fields = {name: tuple(float(v) for v in part) for name, part in parts.items()}
        return replace(start, **fields | {"length": (*fields["length"], start.length[-1])})

    def away(logs: Array) -> Array:
        return np.log(base_ratios(arms_at(logs))[:count] / wanted)

    none = GoalMissed(
        f"no arms near the starting model's have the ratios {np.array2string(wanted, precision=4)}; start from a model "
        "that is nearer to the rig"
    )
    if not np.all(wanted > 0) or not np.isfinite(ratios).all():
        raise none
    logs, step = np.zeros(int(free.sum())), 1e-6
    for _ in range(_STEPS):
        error = away(logs)
        slope: Array = np.array([(away(logs + e) - away(logs - e)) / (2 * step) for e in step * np.eye(len(logs))]).T
        # The point of least norm among those that solve the linearised equations.
        following: Array = np.linalg.lstsq(slope, slope @ logs - error, rcond=None)[0].astype(np.float64)
        if not np.isfinite(following).all() or np.abs(following).max() > 5:
            raise none
        done = np.abs(following - logs).max() < _CLOSE or (np.abs(error).max() < _CLOSE and _small(following - logs))
        logs = following
        if done:
            break
    if np.abs(away(logs)).max() > 1e-10:
        raise none
    arms = arms_at(logs)
    base = arms.base()
    unit = base[1] if n > 1 else base[0]
    friction = np.maximum(np.asarray(ratios)[count:], 0.0).reshape(-1, n) * unit
    names = ("viscous", *start.friction)
    return replace(arms, **{name: tuple(map(float, row)) for name, row in zip(names, friction, strict=True)})


def _small(change: Array) -> bool:
    return bool(np.abs(change).max() < 1e-9)


def with_laws(arms: ArmChainParameters, laws: tuple[Friction, ...]) -> ArmChainParameters:
    """Return the same arms with these laws of friction besides the viscous one, new ones at zero."""
    zero = (0.0,) * arms.count
    return replace(arms, **{law.value: (getattr(arms, law) or zero) if law in laws else () for law in Friction})


_TRIES = 20


@dataclass(frozen=True)
class Uncertainty:
    """How well arms are known: covariance (f, f) of the f ratios of `dpcontrol.dynamics.ratios`, row by row."""

    names: tuple[str, ...]
    covariance: tuple[float, ...]

    @property
    def matrix(self) -> NDArray[np.float64]:
        """The covariance (f, f)."""
        return np.reshape(self.covariance, (len(self.names), len(self.names)))

    def check(self, arms: ArmChainParameters) -> None:
        """Check that this is a covariance of these arms' ratios.

        Raises:
            InputError: names the key and what is allowed.
        """
        wanted = ratio_names(arms)
        if self.names != wanted:
            raise InputError(f"names = {list(self.names)}: must be {list(wanted)} for these arms")
        if len(self.covariance) != len(wanted) ** 2:
            raise InputError(
                f"covariance has {len(self.covariance)} numbers: must have {len(wanted) ** 2}, one row for each name"
            )
        scale = np.sqrt(np.maximum(np.diag(self.matrix), 1e-300))
        scaled = self.matrix / np.outer(scale, scale)
        if not np.allclose(scaled, scaled.T, atol=1e-9) or np.linalg.eigvalsh(scaled)[0] < -1e-6:
            raise InputError(
                "covariance is invalid: it must be symmetric, with no variance below zero in any direction"
            )

    def drawn(self, arms: ArmChainParameters, random: np.random.Generator, *, scale: float = 1.0) -> ArmChainParameters:
        """Return arms as likely as the covariance says of these; friction drawn below zero becomes zero.

        Ratios that no arms have, as of an inertia below zero, are drawn again. scale: factor on the standard errors.

        Raises:
            GoalMissed: no ratios drawn are those of arms, as where an uncertainty is as large as its value.
        """
        ratios = base_ratios(arms)
        sizes, axes = np.linalg.eigh(self.matrix)
        for _ in range(_TRIES):
            away = axes @ (np.sqrt(np.maximum(sizes, 0.0)) * random.standard_normal(len(sizes)))
            try:
                return nearest_arms(ratios + scale * away, arms)
            except GoalMissed:
                continue
        raise GoalMissed(
            f"of {_TRIES} draws from the model's uncertainty, its standard errors times {scale:g}, none are arms that "
            "can be; take a smaller factor"
        )
