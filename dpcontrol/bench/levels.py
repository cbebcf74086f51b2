"""Chart 7: what each level of the model costs and what leaving it out does, per scene."""

from collections.abc import Sequence

from dpcontrol.bench.chart import Chart, Missing, Panel, Point
from dpcontrol.bench.level_trials import CART_MASS, LAG, WINDOW, LevelMotion, gather, motions
from dpcontrol.foundation.progress import Progress
from dpcontrol.scenes.itinerary import Itinerary, load_itinerary
from dpcontrol.scenes.levels import PLANT_LEVELS, REFERENCE_LEVELS, Evidence, LevelRuns
from dpcontrol.scenes.plan import Plan

SCENES = ("outer-turn", "cross", "up-up")
QUICK_SCENES = ("outer-turn",)
_WHY = (
    "the cart level holds all that the rig's identified values tell; its drive is not identified, so what the levels "
    "above add is there for those who know theirs"
)
_PLAN_FLOOR = 1e-4
"""s: of a reference that needs no solver, what it takes to put it together at least."""


def chart(quick: bool, progress: Progress) -> Chart:
    """Return the chart; quick: one scene and fewer seeds. The whole table of scenes is the package's own evidence."""
    names = QUICK_SCENES if quick else SCENES
    panels: list[Panel] = []
    for k, name in enumerate(names):
        progress(f"levels, {name}", k / len(names))
        panels += _panels(load_itinerary(name), seeds=4 if quick else 20)
    return Chart(
        name="levels",
        title="Levels of the model: what each costs, and what leaving the next ones out does",
        panels=tuple(panels),
        reading=(
            f"Motion: a second of motion's time against the arms' distance, after {WINDOW:g} s, from what the fullest "
            f"level does: a cart of {CART_MASS:g} kg, pushed by the arms, its drive's lag {LAG * 1e3:g} ms.",
            "Reference: the solver's time against the effort on a plant that is the model: without friction and cart "
            "in the reference the feedback has to make up for both.",
            "Plant: time against the tracking error's difference from the fullest plant; the data hold effort and how "
            "many runs complete. A level is enough where neither error nor completion changes by more than a fifth.",
        ),
        chosen=(
            "References at the cart level: a conservative one is made at once and costs the loop more. Plants at the "
            "cart level; a drive's lag changes effort, hardly error. `plan` and `run` say where a scene differs."
        ),
    )  # fmt: skip


def _panels(scene: Itinerary, *, seeds: int) -> list[Panel]:
    evidence, plans = gather(scene, seeds=seeds)
    found = motions(plans["cart"].reference, scene.model.arms)
    motion = Panel(
        f"{scene.name}: motion",
        "s per second of motion",
        f"arms' distance from the fullest level after {WINDOW:g} s (scaled)",
        tuple(
            Point(m.level, "", m.seconds, m.error, default=m.level == "cart", yardstick=m.yardstick) for m in found[:-1]
        ),
        {m.level: m.start_up for m in found},
        (Missing(found[-1].level, "", "the fullest level: what the others are measured by"),),
        why=_WHY,
    )
    return [motion, _reference_panel(scene, plans, evidence), _plant_panel(scene, found, evidence)]


def _reference_panel(scene: Itinerary, plans: dict[str, Plan], evidence: Evidence) -> Panel:
    points = tuple(
        _point(level, max(plans[level].reference.solve_seconds, _PLAN_FLOOR), found.effort, found,
               default=level == scene.reference.level)
        for level, found in evidence.references.items()
    )  # fmt: skip
    missing = tuple(
        Missing(level, "", "rest, holds and changes of energy need the cart")
        for level in REFERENCE_LEVELS
        if level not in evidence.references
    )
    return Panel(
        f"{scene.name}: reference",
        "s of the solver",
        "cart's acceleration, m/s² rms",
        points,
        missing=missing,
        why=_WHY,
    )


def _plant_panel(scene: Itinerary, motion: Sequence[LevelMotion], evidence: Evidence) -> Panel:
    runs = evidence.plants
    full, seconds = runs[PLANT_LEVELS[-1]], {m.level: m.seconds for m in motion}
    points = [
        _point(level, seconds[level], abs(found.error - full.error) / full.error, found, default=level == "cart")
        for level, found in runs.items()
    ]
    return Panel(
        f"{scene.name}: plant", "s per second of motion", "tracking error, difference from the fullest plant (share)",
        tuple(points), why=_WHY, log_y=False,
    )  # fmt: skip


def _point(level: str, seconds: float, error: float, runs: LevelRuns, *, default: bool) -> Point:
    return Point(
        level, "", seconds, error, default=default,
        note=f"{runs.completed} of {runs.runs} completed",
        others={"completed": runs.completed, "runs": runs.runs, "effort": runs.effort, "tracking_error": runs.error},
    )  # fmt: skip
