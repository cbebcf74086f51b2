"""Simulated bench recordings: free swings of the lab's pendulum by scipy, in every file format."""

import os
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.integrate import solve_ivp
from scipy.io import savemat

Array = NDArray[np.float64]

PERIOD = 1e-3
LAB = {"m": (0.0938439747983407, 0.137595970499412), "a": (0.108565214610396, 0.116779018445656),
       "l": 0.172719203817519, "J": (0.00043752942975691, 0.00126882939257741), "g": 9.8085802336215,
       "k": (0.000237142782693581, 1.00000019330558e-05)}  # fmt: skip


def rig_file() -> Path:
    """The rig's recorded free swings; the test is skipped without them."""
    folder = os.environ.get("DPCONTROL_LAB_DATA") or Path(__file__).parents[2] / "shared" / "data"
    file = Path(folder) / "lab_free_swing.mat"
    if not file.is_file():
        pytest.skip(f"the rig's recordings are not in {file.parent}; DPCONTROL_LAB_DATA names their folder")
    return file


def _rate(_: float, x: Array) -> Array:
    """The double pendulum's textbook equations from forces, independent of the code's Lagrangian."""
    (m1, m2), (a1, a2), (j1, j2), (k1, k2) = LAB["m"], LAB["a"], LAB["J"], LAB["k"]
    length, g = LAB["l"], LAB["g"]
    q1, q2, w1, w2 = x
    coupling = m2 * length * a2
    mass = np.array([[m1 * a1**2 + m2 * length**2 + j1, coupling * np.cos(q1 - q2)],
                     [coupling * np.cos(q1 - q2), m2 * a2**2 + j2]])  # fmt: skip
    joint = k2 * (w2 - w1)
    force = np.array([
        -coupling * np.sin(q1 - q2) * w2**2 - (m1 * a1 + m2 * length) * g * np.sin(q1) - k1 * w1 + joint,
        coupling * np.sin(q1 - q2) * w1**2 - m2 * a2 * g * np.sin(q2) - joint,
    ])  # fmt: skip
    return np.concatenate([[w1, w2], np.linalg.solve(mass, force)])


@cache
def free_swing(samples: int, start: tuple[float, ...] = (-0.6, 0.35, 4.0, -3.0)) -> tuple[Array, Array]:
    """Return times (K,) and states (K, 4) of a free swing at 1 kHz, angles from hanging."""
    times = PERIOD * np.arange(samples)
    solution = solve_ivp(_rate, (0, times[-1]), start, t_eval=times, rtol=1e-10, atol=1e-12, method="DOP853")
    return times, solution.y.T


def cells(parts: list[Any]) -> NDArray[np.object_]:
    out = np.empty((len(parts), 1), dtype=object)
    for k, part in enumerate(parts):
        out[k, 0] = part
    return out


def rig_variables(segments: int = 2, samples: int = 300) -> dict[str, Any]:
    """Return the variables of a file in the rig's format: 0 is upright, one cell a segment."""
    times, states = free_swing(segments * samples)
    upright = states + np.array([np.pi, np.pi, 0, 0])
    rows = [slice(k * samples, (k + 1) * samples) for k in range(segments)]
    return {
        "Y_id": cells([upright[part].T.copy() for part in rows]),
        "Time_id": cells([times[part, None].copy() for part in rows]),
        "dt": PERIOD,
    }


def write_mat(path: Path, variables: dict[str, Any], *, compressed: bool = False) -> Path:
    savemat(path, variables, do_compression=compressed)
    return path


def write_csv(path: Path, columns: dict[str, Any]) -> Path:
    rows = zip(*columns.values(), strict=True)
    lines = [",".join(columns), *(",".join(str(value) for value in row) for row in rows)]
    path.write_text("\n".join(lines) + "\n")
    return path


def table_columns(samples: int = 300) -> dict[str, list[Any]]:
    """Return the columns of the shipped mapping for tables."""
    times, states = free_swing(samples)
    names = ("time", "angle_1", "angle_2", "rate_1", "rate_2")
    values = (times, *states.T)
    return {name: [float(v) for v in column] for name, column in zip(names, values, strict=True)}
