"""Options that override a scene's run settings, the same for every verb that runs a loop."""

from collections.abc import Callable
from typing import Any, TypeVar

import click

RUN_OPTIONS: dict[str, tuple[type, str]] = {
    "controller": (str, "Kind of controller: tvlqr, adaptive, ogy, ogy-classic, lqr, feedforward."),
    "keep": (str, "What keeps the stops of a walk planned with keep: none, ogy, ogy-classic, tvlqr."),
    "hold": (str, "Where tracking is lost hold the nearest orbit or equilibrium: nearest; or none."),
    "estimator": (str, "Kind of estimator: ekf, ukf, ekf-filterpy."),
    "rate": (float, "Of the loop, Hz."),
    "mismatch": (float, "Share by which the plant's parameters may be off."),
    "model_uncertainty": (float, "Draw the plant from an identified model's uncertainty, its errors times this."),
    "initial_error": (float, "Largest error of each arm's first angle, rad."),
    "counts": (int, "Of an arm's encoder per turn; 0: no rounding."),
    "zero_error": (float, "Largest error of each encoder's zero, rad."),
    "noise": (float, "Standard deviation of the measured joint angles, rad."),
    "missed_counts": (float, "Counts lost per second by a moving encoder."),
    "dropout": (float, "Share of ticks without any reading."),
    "stuck_at": (float, "Time at which an encoder sticks, s."),
    "stuck_sensor": (int, "Which one sticks: 0 the inner arm's, 1 the outer's, 2 the cart's."),
    "jitter": (float, "Greatest age of a reading, s."),
    "rate_noise": (float, "Standard deviation of noise added to estimated rates, rad/s."),
    "delay": (float, "From reading to acting, in periods; may be a fraction."),
    "lag": (float, "Time constant of the drive's velocity loop, s; the model knows nothing of it."),
    "cart_mass": (float, "Of the cart, kg: the arms then push it about."),
    "acceleration": (float, "Limit of the drive, m/s²; the scene's own by default."),
    "jerk": (float, "Limit of the drive, m/s³."),
    "command_noise": (float, "Standard deviation of noise on the command, m/s²."),
    "response": (float, "Share of a command that the drive gives."),
    "travel": (float, "The cart's greatest distance from the centre, m; the plan's own by default, or with 0."),
    "pushes": (int, "Number of random blows on the arms."),
    "push_impulse": (float, "Their greatest impulse, N m s."),
    "knocks": (int, "Number of random blows on the cart."),
    "knock_velocity": (float, "Greatest jump of the cart's velocity by one, m/s."),
    "tilt": (float, "Of the track, rad, right end down."),
}
"""Name, type and help of every run setting that can be given on the command line."""

_F = TypeVar("_F", bound=Callable[..., Any])


def run_options(function: _F) -> _F:
    """Add `--mismatch`, `--lag` and the like to a verb; those not given arrive as None."""
    for name, (kind, text) in reversed(RUN_OPTIONS.items()):
        function = click.option(f"--{name.replace('_', '-')}", name, type=kind, default=None, help=text)(function)
    return function
