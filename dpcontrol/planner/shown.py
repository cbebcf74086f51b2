"""Data for the page's drawings, as JSON.

The data are positions of joints, points of cuts and connections on sections, and time series. The page itself has no
lengths, angles or equations of the arms.
"""

from collections.abc import Sequence
from typing import Any

import numpy as np

from dpcontrol.foundation.arrays import Array
from dpcontrol.foundation.document import picked
from dpcontrol.foundation.errors import InputError
from dpcontrol.logs import RunLog
from dpcontrol.orbits.lyapunov import equilibria
from dpcontrol.pages.atlas import connections_of, section_curves, section_place
from dpcontrol.pages.planes import arm_points
from dpcontrol.plans.model import Model, load_model
from dpcontrol.plans.plan import Plan
from dpcontrol.walks.atlas import Atlas, AtlasConnection, section_axes
from dpcontrol.walks.symbols import Symbol, choose

RATE = 60.0
"""Frame rate of motions, 1/s."""
_FINE = 1e4
"""Positions are integers in units of 0.1 mm."""
_ARMS = ("inner", "outer")
_BEYOND, _BELOW = 0.1, 0.025
"""Slider's end and initial energy above the highest saddle, in energy ranges of all equilibria."""


def joints(angles: Array, lengths: Sequence[float], cart: Array | float = 0.0) -> list[list[int]]:
    """Return the positions (K, 2n+1) of pivot and joints in 0.1 mm, which the page draws as arms.

    Each row has the pivot's x, then x and y (upward) of each arm's end.

    Args:
        angles: angles (K, n) of the arms from hanging, rad.
        lengths: lengths (n,) of the arms, m.
        cart: cart positions (K,) or one for all rows, m.
    """
    points = arm_points(angles, lengths)
    points[..., 0] += np.reshape(cart, (-1, 1))
    rows = points.reshape(len(angles), -1)
    # The pivot has no height.
    return np.rint(_FINE * np.delete(rows, 1, axis=1)).astype(int).tolist()


def energies_of(model: Model) -> tuple[float, float, float]:
    """Return the lowest, the highest and the initial energy (J) that the page's slider offers for a model.

    Args:
        model: model of two arms.
    """
    points = equilibria(model.system).values()
    saddles = [point.energy for point in points if point.kind.startswith("index-1")]
    spread = max(point.energy for point in points) - min(point.energy for point in points)
    lowest, highest = min(saddles) + 0.005 * spread, max(saddles) + _BEYOND * spread
    return float(f"{lowest:.3f}"), float(f"{highest:.3f}"), float(f"{max(saddles) + _BELOW * spread:.2g}")


def shown_model(model: Model) -> dict[str, Any]:
    """Return the data of a model for the page: its equilibria, its remarks, and the energies of the slider."""
    lowest, highest, initial = energies_of(model)
    points = equilibria(model.system).values()
    lengths = model.arms.length
    return {
        "name": model.name,
        "title": model.title,
        "remarks": list(model.remarks),
        "energies": [lowest, highest, initial],
        "reach": sum(lengths),
        "points": [
            {
                "name": point.name,
                "energy": point.energy,
                "kind": point.kind,
                "frame": joints(point.state[None, : len(lengths)], lengths)[0],
            }
            for point in points
        ],
    }


def fitting_model(name: str) -> Model:
    """Return a model by name if the planner can use it, which means that it has two arms.

    Args:
        name: name or path of the model.

    Raises:
        InputError: the model cannot be loaded or does not have two arms.
    """
    model = load_model(name)
    if (count := model.arms.count) != 2:
        reason = {1: "a single arm has no connections"}.get(
            count, f"{count} arms have connections at single energies only: see `dpcontrol guide triple`"
        )
        raise InputError(f"{name}: {reason}; choose a model of two arms")
    return model


def shown_atlas(atlas: Atlas, model: Model) -> dict[str, Any]:
    """Return an atlas as JSON values, which the page draws: orbits, sections and connections.

    Args:
        atlas: atlas of the model.
        model: model of two arms.
    """
    lengths = model.arms.length
    kinds = []
    for kind in atlas.kinds:
        connections = connections_of(atlas, kind)
        # A search without connections is not drawn if there is another one of the same pair, at other hits.
        if not connections and any(k is not kind and (k.source, k.target) == (kind.source, kind.target)
                                   for k in atlas.kinds):  # fmt: skip
            continue
        coordinate, period = section_axes(atlas.cut(kind.source, kind.section, kind.hits[0]).section, atlas)
        curves = [
            {"stable": stable, "forward": sign > 0, "points": np.round(points, 4).tolist()}
            for stable, sign, points in section_curves(atlas, kind)
        ]
        kinds.append({
            "source": kind.source, "target": kind.target, "section": kind.section, "coordinate": coordinate,
            "period": period, "curves": curves,
        })  # fmt: skip
    all_connections = [c for kind in atlas.kinds for c in connections_of(atlas, kind)]
    return {
        "model": atlas.model,
        "energy": atlas.energy,
        "status": atlas.status,
        "absent": [{"saddle": saddle, "reason": reason} for saddle, reason in atlas.absent],
        "orbits": [
            {
                "name": orbit.name,
                "saddle": orbit.saddle,
                "period": orbit.period,
                "frames": joints(orbit.samples[:, : len(lengths)], lengths),
            }
            for orbit in atlas.orbits
        ],
        "kinds": kinds,
        "connections": [_shown_connection(c, atlas, lengths) for c in all_connections],
        "symbols": _symbols(all_connections),
    }


def _shown_connection(c: AtlasConnection, atlas: Atlas, lengths: Sequence[float]) -> dict[str, Any]:
    """Return the data of a connection `c` for the page: its figures, its place on the section, and its motion.

    `lengths` (n,) are those of the arms, m.
    """
    times = np.arange(c.times[0], c.times[-1], 1 / RATE)
    angles = np.column_stack([np.interp(times, c.times, column) for column in c.states[:, : len(lengths)].T])
    return {
        "name": c.name,
        "source": c.source,
        "target": c.target,
        "turns": _turns(c),
        "angle": c.transversality_angle,
        "time": c.time_out + c.time_in,
        "place": np.round(section_place(atlas, c), 5).tolist(),
        "motion": {"rate": RATE, "frames": joints(angles, lengths)},
    }


def _turns(c: AtlasConnection) -> str:
    """Return the whole turns of the arms along a connection in words, such as "inner +1, outer −2"."""
    turns = (f"{arm} {turn:+d}" for arm, turn in zip(_ARMS, c.winding, strict=True) if turn)
    return ", ".join(turns).replace("-", "−") or "no turn"


def _symbols(connections: list[AtlasConnection]) -> dict[str, str]:
    """Return the name of the connection that each short symbol selects, such as "down-up +", for the page's buttons."""
    names: dict[str, str] = {}
    for source, target in dict.fromkeys((c.source, c.target) for c in connections):
        candidates: Any = [c for c in connections if (c.source, c.target) == (source, target)]
        for sense, sign in ((1, " +"), (-1, " -"), (None, "")):
            if any(sense in (None, c.sense) for c in candidates) and (source != target or sense):
                text = f"{source}{sign}" if source == target else f"{source} > {target}{sign}"
                names[text] = choose(Symbol(text, source, target, sense, None), candidates).name
    return names


def shown_plan(plan: Plan) -> dict[str, Any]:
    """Return a plan's motion, the cart's path and the times of symbols as JSON values, which the page plays.

    Args:
        plan: converged plan.
    """
    reference = plan.reference
    times = np.arange(0.0, reference.duration, 1 / RATE)
    states = np.asarray(reference.state(times))
    n = plan.itinerary.model.arms.count
    return {
        "motion": {"rate": RATE, "frames": joints(states[:, :n], plan.itinerary.model.arms.length, states[:, 2 * n])},
        "duration": reference.duration,
        "travel": reference.limits.position,
        "series": {
            "position": np.round(states[:, 2 * n], 5).tolist(),
        },
        "symbols": [picked(symbol, "text", "time") for symbol in plan.content.symbols],
    }


def figures_of(plan: Plan) -> dict[str, Any]:
    """Return the figures of a converged plan that the page shows, such as its effort and its use of limits.

    Args:
        plan: converged plan.
    """
    return {
        "duration": plan.reference.duration,
        "effort": plan.reference.effort,
        "error": plan.reference.max_error_between_nodes,
        "uses": [
            {
                "name": {"position": "travel", "velocity": "speed"}.get(use.name, use.name),
                **picked(use, "unit", "bound", "largest", "time"),
            }
            for use in plan.reference.uses
        ],
    }


def shown_run(log: RunLog) -> dict[str, Any]:
    """Return the motions of a run and of its reference for the page, with the cart's places."""
    times = np.arange(log.time[0], log.time[-1], 1 / RATE)
    n = len(log.arm_lengths)
    rows = np.clip(np.searchsorted(log.time, times), 0, len(log.time) - 1)
    states = log.estimate if log.truth is None else log.truth
    return {
        "motion": {"rate": RATE, "frames": joints(states[rows, :n], log.arm_lengths, states[rows, 2 * n])},
        "ghost": {
            "rate": RATE,
            "frames": joints(log.reference[rows, :n], log.arm_lengths, log.reference[rows, 2 * n]),
        },
        "duration": float(log.time[-1] - log.time[0]),
        "travel": log.limits[0] if log.limits else 0.0,
        "series": {
            "position": np.round(states[rows, 2 * n], 5).tolist(),
            "reference": np.round(log.reference[rows, 2 * n], 5).tolist(),
        },
    }
