"""What a run may change of its scene's settings, by the names that files and options use.

Nothing heavy is imported here: the command line makes its options of these fields.
"""

import shlex
from collections.abc import Mapping
from dataclasses import dataclass, field, fields
from typing import Any

from dpcontrol.foundation.errors import InputError
from dpcontrol.foundation.settings import suggest

PLANT, DISTURBANCES, SENSORS, DRIVE = "Plant", "Disturbances", "Sensors", "Drive"
ESTIMATOR, CONTROLLER, SUPERVISOR = "Estimator", "Controller", "Supervisor"
"""Parts of the bench, as options are listed under them."""


def _option(group: str, text: str, choices: tuple[str, ...] = ()) -> Any:
    return field(default=None, metadata={"group": group, "help": text, "choices": choices})


LAWS = ("tvlqr", "adaptive", "ogy", "ogy-classic", "lqr", "feedforward")
FILTERS = ("ekf", "ukf", "ekf-filterpy")


def settings_to_vary() -> list[str]:
    """Return the beginnings of what `campaign --over` takes."""
    return [f"{one.name}=" for one in fields(RunOptions)]


@dataclass(frozen=True)
class RunOptions:
    """Settings of a run that take the place of its scene's; None keeps. Each field's metadata has its help text.

    controller, estimator and plant may be users' own objects; see `dpcontrol.loop.own`.
    """

    mismatch: float | None = _option(PLANT, "Share by which the plant's parameters may be off.")
    model_uncertainty: float | None = _option(
        PLANT, "Draw the plant from an identified model's uncertainty, its errors times this."
    )
    plant: str | object | None = _option(
        PLANT,
        "Model file or name of the plant's own arms and friction; the mismatch is drawn about them. Or FILE.py:CLASS.",
    )
    friction: float | None = _option(PLANT, "Factor on the plant's friction, unknown to the model.")
    initial_error: float | None = _option(PLANT, "Largest error of each arm's first angle, rad.")
    cart_mass: float | None = _option(PLANT, "Mass of the cart, kg; the arms then push it about.")
    tilt: float | None = _option(PLANT, "Tilt of the track, rad, positive with the right end down.")
    belt: float | None = _option(PLANT, "Frequency of the cart on an elastic belt, Hz; 0: a rigid belt.")
    belt_damping: float | None = _option(PLANT, "Damping ratio of the cart on its belt [0.05].")
    belt_scale: str | None = _option(
        PLANT, "Where the cart's scale sits with a belt: motor, cart [motor].", ("motor", "cart")
    )
    play: float | None = _option(PLANT, "Play between each joint and its encoder, rad.")
    cable_torque: float | None = _option(PLANT, "Torque of a cable on the hanging inner arm, N m.")
    cable_stiffness: float | None = _option(PLANT, "Stiffness of that cable against turning, N m/rad.")
    stiction: float | None = _option(PLANT, "Break-away torque of each joint at rest, N m.")
    kinetic: float | None = _option(PLANT, "Torque of a sliding joint as a share of its break-away torque [0.8].")
    initial_rate: float | None = _option(PLANT, "Largest first rate of each arm, rad/s.")
    initial_cart: float | None = _option(PLANT, "Position of the cart at the start, m.")
    pushes: int | None = _option(DISTURBANCES, "Number of random blows on the arms.")
    push_impulse: float | None = _option(DISTURBANCES, "Their greatest impulse, N m s.")
    knocks: int | None = _option(DISTURBANCES, "Number of random blows on the cart.")
    knock_velocity: float | None = _option(DISTURBANCES, "Greatest jump of the cart's velocity by one, m/s.")
    knocks_per_minute: float | None = _option(
        DISTURBANCES, "Blows on the arms, 1/min, at random times for as long as the run lasts."
    )
    knock_impulse: float | None = _option(DISTURBANCES, "Their greatest impulse, N m s [0.03].")
    counts: int | None = _option(SENSORS, "Counts of an arm's encoder per turn; 0: no rounding.")
    zero_error: float | None = _option(SENSORS, "Largest error of each encoder's zero, rad.")
    zero_drift: float | None = _option(SENSORS, "Rate at which each encoder's zero drifts, either way, rad/h.")
    noise: float | None = _option(SENSORS, "Standard deviation of the measured joint angles, rad.")
    missed_counts: float | None = _option(SENSORS, "Counts that a moving encoder loses, 1/s.")
    dropout: float | None = _option(SENSORS, "Share of ticks without any reading.")
    stuck_at: float | None = _option(SENSORS, "Time at which an encoder sticks, s.")
    stuck_sensor: int | None = _option(SENSORS, "Which one sticks: 0 the inner arm's, 1 the outer's, 2 the cart's.")
    stuck_for: float | None = _option(SENSORS, "For how long it sticks, s [for good].")
    jitter: float | None = _option(SENSORS, "Greatest age of a reading, s.")
    ages: str | None = _option(
        SENSORS, "Whether the bench reports the ages of its readings: reported, unknown.", ("reported", "unknown")
    )
    cart_resolution: float | None = _option(SENSORS, "Resolution of the cart's scale, m; 0: no rounding.")
    delay: float | None = _option(DRIVE, "Delay from reading to acting, in periods; may be a fraction.")
    lag: float | None = _option(DRIVE, "Time constant of the drive's velocity loop, s; see --drive-lag.")
    drive_lag: float | None = _option(DRIVE, "The time constant that the controller knows of, s.")
    acceleration: float | None = _option(DRIVE, "Limit of the drive's acceleration, m/s² [the scene's own].")
    jerk: float | None = _option(DRIVE, "Limit of the drive's jerk, m/s³.")
    command_noise: float | None = _option(DRIVE, "Standard deviation of noise on the command, m/s².")
    response: float | None = _option(DRIVE, "Share of a command that the drive gives.")
    travel: float | None = _option(
        DRIVE, "The cart's greatest distance from the centre, m [the plan's own, as with 0]."
    )
    known_belt: float | None = _option(DRIVE, "Frequency of the belt that the controller knows of, Hz [as --belt].")
    known_play: float | None = _option(ESTIMATOR, "Play that the estimator knows of, rad [as --play].")
    estimator: str | object | None = _option(
        ESTIMATOR, f"Kind of estimator: {', '.join(FILTERS)}; or FILE.py:CLASS.", FILTERS
    )
    rate_noise: float | None = _option(ESTIMATOR, "Standard deviation of noise added to estimated rates, rad/s.")
    controller: str | object | None = _option(
        CONTROLLER, f"Kind of controller: {', '.join(LAWS)}; or FILE.py:CLASS.", LAWS
    )
    keep: str | None = _option(
        CONTROLLER,
        "What keeps the stops of a walk planned with keep: none, ogy, ogy-classic, tvlqr.",
        ("none", "ogy", "ogy-classic", "tvlqr"),
    )
    rate: float | None = _option(CONTROLLER, "Rate of the loop, Hz.")
    hold: str | None = _option(
        SUPERVISOR,
        "Where tracking is lost, hold the nearest orbit or equilibrium: nearest; or none.",
        ("none", "nearest"),
    )
    on_fall: str | None = _option(
        SUPERVISOR,
        "After a fall: stop; resume, from rest at the symbol that failed; or restart the itinerary.",
        ("stop", "resume", "restart"),
    )
    attempts: int | None = _option(SUPERVISOR, "Attempts of one symbol until the run ends; 0: no limit.")

    def given(self) -> dict[str, Any]:
        """Return the settings that are given, by name."""
        values = {f.name: getattr(self, f.name) for f in fields(self)}
        return {name: value for name, value in values.items() if value is not None}

    @property
    def typed(self) -> str:
        """The options as the command line reads them, such as `--travel 0.6`."""
        texts = {name: str(value) for name, value in self.given().items()}
        return " ".join(f"--{name.replace('_', '-')} {shlex.quote(text)}" for name, text in texts.items())

    def over(self, options: Mapping[str, Any]) -> "RunOptions":
        """Return the options with others by name in their place.

        Raises:
            InputError: an unknown name.
        """
        names = [f.name for f in fields(self)]
        for name, value in options.items():
            if name not in names:
                raise InputError(f"{name} = {value!r}: no such run setting; {suggest(name, names)}")
        return RunOptions(**{**self.given(), **options})
