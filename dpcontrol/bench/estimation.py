"""Chart 4: estimators, their error and consistency against the time of a tick, over the resolution of the encoders."""

from collections.abc import Callable
from functools import partial

from dpcontrol.bench.chart import Chart, Panel, Point
from dpcontrol.bench.derivative_filter import DerivativeFilter
from dpcontrol.bench.estimator_trials import (
    PERIOD,
    Swing,
    Trial,
    derivative_trial,
    estimator_trial,
    noise_of,
    one_step,
    swing,
)
from dpcontrol.bench.measure import Timed, timed_in_turns
from dpcontrol.control.ekf import CompiledEkf
from dpcontrol.control.estimation import make_estimator
from dpcontrol.control.estimator_settings import EkfSettings, EstimatorSettings, FilterpyEkfSettings, UkfSettings
from dpcontrol.control.model import SampledModel
from dpcontrol.dynamics.chain import ArmChainParameters, Level, equations_of
from dpcontrol.foundation.progress import Progress
from dpcontrol.scenes.model import load_model

MISMATCH = 0.02
ZERO_ERROR = 3e-3
"""rad, about what an arm's resting place is read to."""
RESOLUTIONS = (512, 4000, 40_000, 400_000)
QUICK_RESOLUTIONS = (4000, 40_000)
CUTOFFS = (10.0, 30.0, 100.0)
"""Hz; without a low pass besides."""
DEFAULT = ("EKF, compiled", "+".join(EkfSettings().augment) or "state only")
AUGMENTS: tuple[tuple[str, ...], ...] = ((), ("zeros",), ("zeros", "friction", "parameters"))
_METHODS: tuple[tuple[str, type[EstimatorSettings]], ...] = (
    ("EKF, compiled", EkfSettings), ("EKF, filterpy", FilterpyEkfSettings), ("UKF, filterpy", UkfSettings)
)  # fmt: skip
_WHY = (
    "zeros of a few milliradians are what a feedback on the state alone fails by, and finding them costs less than "
    "twice the time; parameters are estimated where a controller asks for them"
)


def chart(quick: bool, progress: Progress) -> Chart:
    """Return the chart; quick: two resolutions, one second of one swing, the UKF with and without zeros only."""
    arms = load_model("lab").arms
    resolutions = QUICK_RESOLUTIONS if quick else RESOLUTIONS
    seconds, seeds = (1.0, 1) if quick else (3.0, 3)
    swings = [swing(arms, seconds=seconds, seed=k, mismatch=MISMATCH, zero_error=ZERO_ERROR) for k in range(seeds)]
    panels = []
    for k, counts in enumerate(resolutions):
        progress(f"estimation, {counts} counts", k / len(resolutions))
        panels.append(_panel(arms, swings, counts, quick=quick))
    return Chart(
        name="estimation",
        title=f"Estimation: plant off by {MISMATCH:.0%}, encoders' zeros by {ZERO_ERROR * 1e3:g} mrad",
        panels=tuple(panels),
        reading=(
            "Each point: an estimator on the same swings; across, a tick's time; up, the rms scaled error of angles "
            "and rates; a panel for each encoder.",
            "Points by their extras: what is estimated besides the state. Differences have no model to be wrong about, "
            "and no covariance that would tell.",
            "The data hold the shares of NIS and NEES inside their 95 % bands: below 0.9 the estimator believes too "
            "much, near 1.0 too little.",
        ),
        chosen=(
            "The compiled EKF: the same numbers as filterpy's in a fraction of the time, and the UKF is no better "
            "here. Differences are as good only where counts are finer than the rig's, and then tell nothing of zeros."
        ),
    )  # fmt: skip


def _panel(arms: ArmChainParameters, swings: list[Swing], counts: int, *, quick: bool) -> Panel:
    model = SampledModel(equations_of(arms, Level.CART), arms.base(), period=PERIOD)
    steps: dict[tuple[str, str], Callable[[], object]] = {}
    trials: dict[tuple[str, str], Trial] = {}
    compiled = []
    for name, settings in _METHODS:
        for augment in AUGMENTS[:2] if quick and settings is UkfSettings else AUGMENTS:
            estimator = make_estimator(settings(augment=augment), model, noise=noise_of(arms, counts))
            key = name, "+".join(augment) or "state only"
            steps[key] = one_step(estimator, swings[0], counts=counts)
            trials[key] = estimator_trial(estimator, swings, counts=counts)
            if isinstance(estimator, CompiledEkf):
                compiled.append(key)
    measured = swings[0].measured(counts)[:, : arms.count]
    rates = swings[0].states[0, arms.count : 2 * arms.count]
    for cutoff in (*CUTOFFS, float("inf")):
        law = DerivativeFilter(PERIOD, cutoff)
        key = "differences", f"{cutoff:g} Hz" if cutoff < float("inf") else "no low pass"
        steps[key] = partial(law.step, rates, measured[0], measured[1])
        trials[key] = derivative_trial(law, swings, counts=counts)
    spent = timed_in_turns(steps)
    points = [_point(*key, spent[key], trials[key], default=key == DEFAULT) for key in steps]
    start_up = {", ".join(key): spent[key].start_up for key in compiled}
    return Panel(
        title=f"{counts} counts per turn",
        x_label="s per tick",
        y_label="rms error of the arms' state (scaled)",
        points=tuple(points),
        start_up=start_up,
        why=_WHY,
    )


def _point(method: str, setting: str, spent: Timed[object], trial: Trial, *, default: bool = False) -> Point:
    found = {"nis_inside_95": trial.nis_inside_95, "nees_inside_95": trial.nees_inside_95}
    others = {name: value for name, value in found.items() if value == value}
    note = f"NIS {trial.nis_inside_95:.0%}, NEES {trial.nees_inside_95:.0%} inside" if others else "no covariance"
    # Two programs for the same equations differ by rounding, which shall not decide the front.
    error = float(f"{trial.error:.6g}")
    return Point(
        method, setting, spent.seconds, error, default=default, note=note, others=others, yardstick=spent.yardstick
    )
