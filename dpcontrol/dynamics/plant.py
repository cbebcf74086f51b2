"""What really moves on the bench: arms on a cart whose drive follows at once, lags, or pushes with a finite force.

    cart:   ẍ = u
    drive:  ẍ = a,  ȧ = (u - a)/τ                    a velocity loop: a = (w - ẋ)/τ on its reference ẇ = u
    force:  d/dt ∂L/∂ẋ + k_c ẋ = F + M b,  F = M a,  ȧ = (u - ẍ)/τ             the arms push the cart about

M: mass of cart and arms together. A heavy cart makes `force` into `drive`, a fast loop makes `drive` into `cart`. At
every level gravity may pull along the track too, as on a track that is tilted: b m/s², with the Lagrangian's further
term b (Σ S_i sin θ_i + M x). Angles are then still measured from the track's normal.

Source: Åström & Murray, Feedback Systems (2008), section 2.2 and example 2.1 (balance systems).
"""

import math
from dataclasses import dataclass, replace
from enum import StrEnum
from functools import cache
from types import SimpleNamespace

import casadi as ca
import numpy as np

from dpcontrol.dynamics.chain import ArmChainParameters, Friction, Level, arm_chain_equations, chain_energies
from dpcontrol.dynamics.compiled import Compiled, compiled_step
from dpcontrol.dynamics.equations import Equations, Mechanics, mechanics, solve_symmetric
from dpcontrol.foundation.arrays import Array
from dpcontrol.foundation.errors import InputError
from dpcontrol.foundation.settings import Settings, setting

_SMOOTH_STEP = 2e-3
"""s: the longest step at which the arms' own motion is exact to 1e-12."""
_SHARE_OF_LAG = 0.25
_COULOMB_STEP = 2.5e-4


class PlantLevel(StrEnum):
    """How the cart follows a commanded acceleration."""

    CART = "cart"
    DRIVE = "drive"
    FORCE = "force"


@dataclass(frozen=True)
class PlantParameters(Settings):
    """The arms and what carries them.

    lag s: time constant of the drive's velocity loop, zero for one that follows at once. cart_mass kg without the
    arms, zero for a cart that the arms cannot move; cart_viscous N s/m. tilt rad of the track, positive where its
    right end is the lower one: gravity then pulls by g sin(tilt) along it, by g cos(tilt) across.
    """

    arms: ArmChainParameters
    lag: float = setting(0.0, least=1e-5, most=1, zero="a drive that follows at once", unit="s")
    cart_mass: float = setting(0.0, least=0, most=1e6, unit="kg")
    cart_viscous: float = setting(0.0, least=0, most=1e6, unit="N s/m")
    tilt: float = setting(0.0, least=-np.pi / 4, most=np.pi / 4, unit="rad")

    def _check_together(self) -> None:
        """Check what a cart with mass or friction needs."""
        if self.cart_mass > 0 and self.lag == 0:
            raise InputError(
                f"cart_mass = {self.cart_mass!r} with lag = 0: a cart with a mass needs the time constant of the "
                "velocity loop that moves it; give a lag, such as 0.002 s, or no mass"
            )
        if self.cart_viscous > 0 and self.cart_mass == 0:
            raise InputError(
                f"cart_viscous = {self.cart_viscous!r} with cart_mass = 0: friction needs a cart with mass; give one"
            )

    @property
    def level(self) -> PlantLevel:
        """The least level that serves these parameters."""
        return PlantLevel.FORCE if self.cart_mass else PlantLevel.DRIVE if self.lag else PlantLevel.CART

    @property
    def equations(self) -> Equations:
        """The equations that go with `numbers`."""
        return plant_equations(self.arms.count, self.level, friction=self.arms.friction)

    def numbers(self) -> Array:
        """Return the parameters (p,) of `equations`: base parameters, b, then τ, then M and k_c where they occur."""
        upright = replace(self.arms, gravity=self.arms.gravity * float(np.cos(self.tilt)))
        further = [self.arms.gravity * np.sin(self.tilt)]
        if self.level is not PlantLevel.CART:
            further.append(self.lag)
        if self.level is PlantLevel.FORCE:
            further += [self.cart_mass + sum(self.arms.mass), self.cart_viscous]
        return np.concatenate([upright.base(), further])


@cache
def _symbols() -> SimpleNamespace:
    """Return those that all levels share: b, τ, M, k_c and F."""
    return SimpleNamespace(**{name: ca.SX.sym(name) for name in ("pull", "lag", "mass", "drag", "force")})


@cache
def _parts(count: int, friction: tuple[Friction, ...], *, free_cart: bool) -> Mechanics:
    """Return arms on a track that may be tilted, with a cart that moves as prescribed or is free."""
    n, chain, s = count, chain_energies(count, friction=friction), _symbols()

    def lagrangian(q: ca.SX, v: ca.SX, p: ca.SX) -> ca.SX:
        total = chain.lagrangian(q, v, p) + s.pull * ca.dot(chain.coupling, ca.sin(q[:n]))
        # The chain's own Lagrangian stands on a cart of 1 kg.
        return total + (s.mass - 1) * v[n] ** 2 / 2 + (s.force + s.mass * s.pull) * q[n] if free_cart else total

    def dissipation(q: ca.SX, v: ca.SX, p: ca.SX) -> ca.SX:
        return chain.dissipation(q, v, p) + (s.drag * v[n] ** 2 / 2 if free_cart else 0)

    free, prescribed = (n + 1, 0) if free_cart else (n, 1)
    return mechanics(lagrangian, dissipation, free=free, prescribed=prescribed, parameters=chain.parameters)


def _parameters(count: int, level: PlantLevel, friction: tuple[Friction, ...]) -> ca.SX:
    s = _symbols()
    further = {PlantLevel.CART: [s.pull], PlantLevel.DRIVE: [s.pull, s.lag],
               PlantLevel.FORCE: [s.pull, s.lag, s.mass, s.drag]}  # fmt: skip
    return ca.vertcat(chain_energies(count, friction=friction).parameters, *further[level])


def _state(q: ca.SX, v: ca.SX, demand: ca.SX, level: PlantLevel) -> ca.SX:
    n = q.shape[0] - 1
    cart = ca.vertcat(q[:n], v[:n], q[n], v[n])
    return cart if level is PlantLevel.CART else ca.vertcat(cart, demand)


@cache
def plant_equations(count: int, level: PlantLevel, *, friction: tuple[Friction, ...] = ()) -> Equations:
    """Return the equations of `count` arms on the bench at `level`.

    State: angles, rates, cart position and velocity, then (levels drive and force) a, the acceleration that the
    drive's velocity loop demands; the input is the commanded acceleration u. Parameters as `PlantParameters.numbers`.
    """
    n, s = count, _symbols()
    u, a = ca.SX.sym("u"), ca.SX.sym("a")
    parts = _parts(count, friction, free_cart=level is PlantLevel.FORCE)
    q, v, given, free = parts.position, parts.velocity, parts.acceleration, parts.free_acceleration
    if level is PlantLevel.FORCE:
        moving = ca.substitute(free, s.force, s.mass * a)
    else:
        given_now = u if level is PlantLevel.CART else a
        moving = ca.vertcat(ca.substitute(free, given, given_now), given_now)
    rate = ca.vertcat(v[:n], moving[:n], v[n], moving[n])
    if level is not PlantLevel.CART:
        rate = ca.vertcat(rate, (u - moving[n]) / s.lag)
    state = _state(q, v, a, level)
    arms = arm_chain_equations(count, Level.CART, friction=friction)
    energies = [arms.hamiltonian, arms.momentum, arms.mass_matrix]
    hamiltonian, momentum, mass = ca.substitute(energies, [arms.state], [state[: 2 * n + 2]])
    return Equations(state, u, _parameters(count, level, friction), ca.cse(rate), hamiltonian, momentum, mass)


@cache
def blow(count: int, level: PlantLevel, *, friction: tuple[Friction, ...] = ()) -> ca.Function:
    """Return (state, impulses (n,), jumps (n,), knock, parameters) -> state after a blow that takes no time.

    impulses N m s: a couple on each arm; jumps rad/s of the arms' rates; knock m/s: jump of the cart's velocity, in
    which the arms keep their momenta. The drive's loop answers what moves its cart.
    """
    n, s = count, _symbols()
    parts = _parts(count, friction, free_cart=False)
    q, v = parts.position, parts.velocity
    impulses, jumps, knock, a = ca.SX.sym("p", n), ca.SX.sym("j", n), ca.SX.sym("k"), ca.SX.sym("a")
    if level is PlantLevel.FORCE:
        whole = _parts(count, friction, free_cart=True)
        mass = ca.substitute(whole.mass_matrix, ca.vertcat(whole.position, whole.velocity), ca.vertcat(q, v))
        moved = solve_symmetric(mass, ca.vertcat(impulses, 0))
    else:
        moved = ca.vertcat(solve_symmetric(parts.mass_matrix, impulses), 0)
    cart = moved[n] + knock
    rates = v[:n] + moved[:n] + jumps + ca.jacobian(parts.free_acceleration, parts.acceleration) * knock
    after = ca.vertcat(q[:n], rates, q[n], v[n] + cart)
    if level is not PlantLevel.CART:
        after = ca.vertcat(after, a - cart / s.lag)
    parameters = _parameters(count, level, friction)
    inputs = [_state(q, v, a, level), impulses, jumps, knock, parameters]
    names = ["state", "impulses", "jumps", "knock", "parameters"]
    return ca.Function("blow", inputs, [ca.cse(ca.densify(after))], names, ["after"])


@cache
def plant_step(count: int, level: PlantLevel, *, friction: tuple[Friction, ...] = ()) -> Compiled:
    """Return `fixed_step` of `plant_equations` as machine code, made once in a process."""
    return compiled_step(plant_equations(count, level, friction=friction))


def longest_step(plant: PlantParameters) -> float:
    """Return the longest single step of `plant_step`, in s, whose error is near round-off: 1e-11 at usual states.

    Coulomb friction turns within a fraction of a millisecond, where a joint's rate changes its sign; 1e-10 is left
    there where arms turn slowly, 1e-7 where they are struck by 2000 rad/s².
    """
    longest = min(_SMOOTH_STEP, _SHARE_OF_LAG * plant.lag if plant.lag else math.inf)
    return min(longest, _COULOMB_STEP) if Friction.COULOMB in plant.arms.friction else longest


def after_blow(
    plant: PlantParameters, state: Array, *, impulses: Array | None = None, jumps: Array | None = None, knock: float = 0
) -> Array:
    """Return the state (N,) after a blow: a couple's impulses (n,) N m s, jumps (n,) rad/s, the cart's knock m/s."""
    n = plant.arms.count
    function = blow(n, plant.level, friction=plant.arms.friction)
    none = np.zeros(n)
    out = function(state, none if impulses is None else impulses, none if jumps is None else jumps, knock,
                   plant.numbers())  # fmt: skip
    return np.asarray(out, dtype=float).ravel()
