"""The equations of motion, compared with a Lagrangian derived independently from the masses' positions."""

from dataclasses import replace

import numpy as np
import pytest

from dpcontrol.dynamics.chain import ArmChainParameters, Level, arm_chain_equations, equations_of
from dpcontrol.dynamics.equations import NumericEquations
from dpcontrol.plans.model import load_model

# Relative error of central differences with step 1e-5.
DIFFERENCES = 1e-7
EXACT = 1e-12

THREE_ARMS = ArmChainParameters(
    mass=(0.26, 0.28, 0.12),
    centre_of_mass=(0.16, 0.2, 0.18),
    length=(0.17, 0.23, 0.3),
    inertia=(1e-3, 3e-4, 2e-4),
    gravity=9.81,
    viscous=(1e-3, 3e-4, 1e-4),
)


def lagrangian_from_positions(p, q, v):
    """L of arms on a cart from positions and velocities of the centres of mass; q, v: angles then cart."""
    n = p.count
    joint, joint_speed, energy = np.array([q[n], 0.0]), np.array([v[n], 0.0]), 0.0
    for i in range(n):
        along, across = np.array([np.sin(q[i]), -np.cos(q[i])]), np.array([np.cos(q[i]), np.sin(q[i])])
        centre, speed = joint + p.centre_of_mass[i] * along, joint_speed + p.centre_of_mass[i] * v[i] * across
        energy += p.mass[i] * speed @ speed / 2 + p.inertia[i] * v[i] ** 2 / 2 - p.mass[i] * p.gravity * centre[1]
        joint, joint_speed = joint + p.length[i] * along, joint_speed + p.length[i] * v[i] * across
    return energy


def residual_of_euler_lagrange(p, state, rate, u):
    """d/dt ∂L/∂v - ∂L/∂q + ∂D/∂v of the angles, by central differences along the motion."""
    n, h = p.count, 1e-5
    q, v = np.append(state[:n], state[2 * n]), np.append(state[n : 2 * n], state[2 * n + 1])
    a = np.append(rate[n : 2 * n], u)
    steps = np.eye(n + 1) * h

    def momentum(q, v):
        # L is quadratic in v, so central differences are exact for any step.
        ones = np.eye(n + 1)
        return np.array(
            [(lagrangian_from_positions(p, q, v + s) - lagrangian_from_positions(p, q, v - s)) / 2 for s in ones]
        )[:n]

    force = np.array(
        [(lagrangian_from_positions(p, q + s, v) - lagrangian_from_positions(p, q - s, v)) / (2 * h) for s in steps]
    )[:n]
    change = (momentum(q + h * v, v + h * a) - momentum(q - h * v, v - h * a)) / (2 * h)
    relative = np.diff(np.concatenate([[0.0], v[:n]]))
    torque = np.asarray(p.viscous) * relative
    return change - force + torque - np.append(torque[1:], 0.0)


@pytest.mark.parametrize("arms", [load_model("lab").parameters, THREE_ARMS], ids=["lab", "three arms"])
def test_cart_level_satisfies_euler_lagrange_from_positions(arms):
    equations = arm_chain_equations(arms.count, Level.CART)
    f = equations.function()
    random = np.random.default_rng(1)
    for _ in range(20):
        state = random.uniform(-3, 3, equations.dimension)
        u = random.uniform(-10, 10)
        rate = np.array(f(state, u, arms.base())).ravel()
        assert np.abs(residual_of_euler_lagrange(arms, state, rate, u)).max() < DIFFERENCES
        assert rate[-2] == state[-1]
        assert rate[-1] == u


@pytest.mark.parametrize("count", [1, 2, 3])
def test_a_level_without_its_additions_equals_the_level_below(count):
    parts = {k: getattr(THREE_ARMS, k)[:count] for k in ("mass", "centre_of_mass", "length", "inertia", "viscous")}
    arms = replace(THREE_ARMS, **parts)
    cart, dissipative, conservative = (
        arm_chain_equations(count, level).function() for level in (Level.CART, Level.DISSIPATIVE, Level.CONSERVATIVE)
    )
    x = np.random.default_rng(2).uniform(-3, 3, 2 * count)
    on_cart = np.array(cart(np.append(x, [0.3, -0.2]), 0.0, arms.base())).ravel()
    with_friction = np.array(dissipative(x, [], arms.base())).ravel()
    without = np.array(dissipative(x, [], arms.frictionless().base())).ravel()
    assert np.allclose(on_cart[: 2 * count], with_friction, rtol=EXACT, atol=EXACT)
    assert np.allclose(without, np.array(conservative(x, [], arms.base())).ravel(), rtol=EXACT, atol=EXACT)
    assert not np.allclose(with_friction, without, rtol=1e-6, atol=0)


def test_energy_is_zero_at_the_pivots_height_and_excludes_the_cart():
    arms = load_model("lab").parameters
    numeric = NumericEquations(arm_chain_equations(2, Level.CONSERVATIVE), arms.base())
    on_cart = NumericEquations(arm_chain_equations(2, Level.CART), arms.base())
    level = np.array([np.pi / 2, -np.pi / 2, 0.0, 0.0])
    assert abs(numeric.hamiltonian(level)) < EXACT
    moving = np.array([0.3, 2.0, 4.0, -3.0])
    assert on_cart.hamiltonian(np.append(moving, [0.2, 1.5])) == pytest.approx(numeric.hamiltonian(moving), rel=EXACT)


def test_mismatch_varies_each_parameter_within_its_band_and_is_repeatable():
    arms = load_model("lab").parameters
    drawn = [arms.mismatched(0.02, np.random.default_rng(seed)) for seed in range(200)]
    for name, band in (("mass", 0.02), ("centre_of_mass", 0.02), ("length", 0.02), ("inertia", 0.02), ("viscous", 0.1)):
        ratios = np.array([getattr(d, name) for d in drawn]) / np.array(getattr(arms, name))
        assert np.abs(ratios - 1).max() <= band
        assert np.abs(ratios - 1).max() > 0.9 * band
        assert abs(np.corrcoef(ratios.T)[0, 1]) < 0.3
    assert {d.gravity for d in drawn} == {arms.gravity}
    assert drawn[3] == arms.mismatched(0.02, np.random.default_rng(3))
    # Beyond a fifth, the band of friction would include negative values.
    assert min(min(arms.mismatched(0.5, np.random.default_rng(s)).viscous) for s in range(50)) >= 0.0


def with_all_friction(arms: ArmChainParameters) -> ArmChainParameters:
    n = arms.count
    return replace(arms, coulomb=(2e-3, 5e-4, 1e-4)[:n], quadratic=(3e-3, 1e-2, 2e-3)[:n], smoothing=0.2)


def torque_of_drag(p, state):
    """The moment about each joint, as generalised force, of the drag -b v √(v² + (λw)²) at centres of oscillation."""
    n = p.count
    q, v = state[:n], state[n : 2 * n]
    torque, velocity = np.zeros(n), np.array([state[2 * n + 1], 0.0])
    reach = np.zeros((n, 2))
    for i in range(n):
        beyond = sum(p.mass[i + 1 :])
        swung = p.inertia[i] + p.mass[i] * p.centre_of_mass[i] ** 2 + beyond * p.length[i] ** 2
        distance = swung / (p.mass[i] * p.centre_of_mass[i] + beyond * p.length[i])
        across = np.array([np.cos(q[i]), np.sin(q[i])])
        at = velocity + distance * v[i] * across
        force = -p.quadratic[i] * at * np.hypot(np.linalg.norm(at), distance * p.smoothing)
        reach[i] = distance * across
        torque[: i + 1] += reach[: i + 1] @ force
        reach[i] = p.length[i] * across
        velocity = velocity + p.length[i] * v[i] * across
    return torque


@pytest.mark.parametrize("arms", [load_model("lab").parameters, THREE_ARMS], ids=["lab", "three arms"])
def test_each_joint_has_its_coulomb_torque_and_each_arm_its_air_drag(arms):
    rubbing = with_all_friction(arms)
    n = arms.count
    mass = NumericEquations(arm_chain_equations(n, Level.CONSERVATIVE), arms.base())
    with_laws = equations_of(rubbing, Level.CART).function()
    without = equations_of(arms, Level.CART).function()
    for state in np.random.default_rng(3).uniform(-3, 3, (20, 2 * n + 2)):
        change = np.array(with_laws(state, 1.0, rubbing.base()) - without(state, 1.0, arms.base())).ravel()
        relative = np.diff(np.concatenate([[0.0], state[n : 2 * n]]))
        torque = np.asarray(rubbing.coulomb) * relative / np.hypot(relative, rubbing.smoothing)
        expected = -(torque - np.append(torque[1:], 0.0)) + torque_of_drag(rubbing, state)
        assert np.allclose(mass.mass_matrix(state[: 2 * n]) @ change[n : 2 * n], expected, rtol=1e-9, atol=1e-12)


def test_mismatch_draws_the_same_arms_with_and_without_other_friction_laws():
    arms = load_model("lab").parameters
    plain, rubbing = (a.mismatched(0.1, np.random.default_rng(4)) for a in (arms, with_all_friction(arms)))
    assert rubbing.viscous_only() == replace(plain, smoothing=0.2)
    assert rubbing.coulomb != with_all_friction(arms).coulomb
    assert rubbing.smoothing == 0.2
