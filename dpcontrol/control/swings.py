"""Swings of the arms from many starts at once, with their sensitivities to start and parameters.

    x_{k+1} = F(x_k, p; u),    S_{k+1} = ∂F/∂x S_k + [0  ∂F/∂p],    S = [∂x/∂x_0  ∂x/∂p]

F is one classical Runge-Kutta step (order 4), p the ratios of `dpcontrol.dynamics.base_ratios`; the cart is clamped or
follows an acceleration. Written once in casadi, compiled once in a process, for as
many swings at once as the processor's vectors hold.

Source: Hairer, Nørsett, Wanner, Solving ordinary differential equations I (1993), section I.14.
"""

from dataclasses import replace
from functools import cache

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from dpcontrol.dynamics.arm_chain import Level, equations_of
from dpcontrol.dynamics.base_ratios import base_from_ratios, ratio_names
from dpcontrol.dynamics.compiled import Compiled
from dpcontrol.dynamics.parameters import ArmChainParameters

Array = NDArray[np.float64]

LONGEST_STEP = 2e-3
"""s. Steps of 1 ms are off by 1e-7 rad at the rig's rates, most of it where Coulomb friction changes sides."""


class Swings:
    """Swings of `arms`: their count, gravity and laws of friction; the parameters' values are given with each call.

    Not to be shared between threads.
    """

    def __init__(self, arms: ArmChainParameters) -> None:
        self.arms = arms
        self.states = 2 * arms.count
        self.parameters = len(ratio_names(arms))

    def flown(
        self,
        starts: Array,
        parameters: Array,
        *,
        period: Array,
        samples: int,
        accelerations: Array | None = None,
        velocities: Array | None = None,
    ) -> tuple[Array, Array]:
        """Return states (W, K, N) and sensitivities (W, K, N, N+m) at `samples` = K times from each start (W, N).

        parameters (m,) ratios; period (W,) s between samples; accelerations (W, K) m/s² of the cart, held from each
        sample to the next, and velocities (W, K) m/s at it, zero if not given.
        """
        w, n, m = len(starts), self.states, self.parameters
        size = n + n * (n + m)
        substeps = int(np.ceil(period.max() / LONGEST_STEP - 1e-9))
        held, out = np.empty((size + m + 3, w)), np.empty((size, w))
        held[:n] = starts.T
        held[n:size] = np.eye(n, n + m).T.reshape(-1, 1)
        held[size : size + m] = parameters[:, None]
        held[size + m] = period / substeps
        held[size + m + 1 :] = 0.0
        every = np.empty((samples, size, w))
        step = _compiled(_nominal(self.arms))
        every[0] = held[:size]
        for k in range(1, samples):
            if accelerations is not None and velocities is not None:
                held[size + m + 1] = accelerations[:, k - 1]
                held[size + m + 2] = velocities[:, k - 1]
            for _ in range(substeps):
                step(held, out)
                held[:size] = out
                if accelerations is not None:
                    held[size + m + 2] += held[size + m] * held[size + m + 1]
            every[k] = out
        states = every[:, :n].transpose(2, 0, 1)
        return states, every[:, n:].reshape(samples, n + m, n, w).transpose(3, 0, 2, 1)


def _nominal(arms: ArmChainParameters) -> ArmChainParameters:
    """Return arms that stand for all of the same count, gravity, laws of friction and smoothing."""
    one = (1.0,) * arms.count
    names = ("mass", "centre_of_mass", "length", "inertia", "viscous", *arms.friction)
    return replace(arms, **dict.fromkeys(names, one))


@cache
def _compiled(arms: ArmChainParameters) -> Compiled:
    """Return (x, vec S, p, (h, u, v)) -> (x, vec S) one step later; compiling takes longer than most fits."""
    n, m = 2 * arms.count, len(ratio_names(arms))
    rate = equations_of(arms, Level.CART).function()
    x, p, drive = ca.SX.sym("x", n), ca.SX.sym("p", m), ca.SX.sym("drive", 3)
    h, u, velocity = drive[0], drive[1], drive[2]
    base = ca.vertcat(*base_from_ratios(p, arms))

    def slope(state: ca.SX, after: ca.SX) -> ca.SX:
        return rate(ca.vertcat(state, 0, velocity + after * u), u, base)[:n]

    k1 = slope(x, ca.SX(0))
    k2 = slope(x + h / 2 * k1, h / 2)
    k3 = slope(x + h / 2 * k2, h / 2)
    k4 = slope(x + h * k3, h)
    following = x + h / 6 * (k1 + 2 * k2 + 2 * k3 + k4)
    s = ca.SX.sym("S", n, n + m)
    forward = ca.jacobian(following, x) @ s + ca.horzcat(ca.SX.zeros(n, n), ca.jacobian(following, p))
    out = ca.cse(ca.densify(ca.vertcat(following, ca.vec(forward))))
    return Compiled(ca.Function("swing", [ca.vertcat(x, ca.vec(s)), p, drive], [out]))
