"""References on disk: one .npz file, readable with numpy alone (`numpy.load(path)`).

Keys, all float64 unless said otherwise:

    header   JSON text (a 0-d string array): {"format": "dpcontrol-reference", "version": 2, "method": "radau-5",
             "status": text, "converged": bool, "limits": {"position", "velocity", "acceleration"},
             "numbers": {the result's figures by name}, "notes": {what the caller stored}}
    mesh     (N+1,)        interval ends, s
    points   (K,)          collocation points of an interval scaled to 0 … 1
    support  (K+1,)        where the states are given on it (version 1: 0 and the points)
    states   (N, K+1, nx)  at the support: angles, rates, cart position, cart velocity
    inputs   (N, K, nu)    at the points: cart acceleration, m/s²
    extra_*  any shape     arrays the caller stored, by name

The state on an interval is the polynomial through its K+1 values, the input the one through its K values.
"""

import json
from pathlib import Path
from types import MappingProxyType
from typing import IO, Any

import numpy as np
from numpy.typing import NDArray

from dpcontrol.foundation.archives import archive
from dpcontrol.foundation.errors import InputError
from dpcontrol.foundation.files import whole_file
from dpcontrol.references.method import method_named
from dpcontrol.references.problem import Limits
from dpcontrol.references.reference import Reference

Array = NDArray[np.float64]

FORMAT = "dpcontrol-reference"
VERSION = 2
READ = (1, 2)
"""Versions that are read."""
_EXTRA = "extra_"
_NUMBERS = (
    "max_error_between_nodes",
    "constraint_violation",
    "max_cart_position",
    "max_cart_velocity",
    "max_cart_acceleration",
    "rms_cart_acceleration",
    "iterations",
    "solve_seconds",
)


def save_reference(path: Path, reference: Reference) -> None:
    """Write `reference` to `path` (whole, or not at all) in the layout above.

    Raises:
        InputError: the file cannot be written, or the notes are not JSON.
    """
    header = {
        "format": FORMAT,
        "version": VERSION,
        "method": reference.method.name,
        "status": reference.status,
        "converged": reference.converged,
        "limits": reference.limits.named(),
        # JSON has no infinity: null stands for a figure that was not measured.
        "numbers": {name: value if np.isfinite(value := getattr(reference, name)) else None for name in _NUMBERS},
        "notes": dict(reference.notes),
    }
    try:
        text = json.dumps(header, allow_nan=False)
    except (TypeError, ValueError) as error:
        raise InputError(f"cannot write {path}: the notes are not plain JSON ({error})") from error
    arrays: dict[str, Any] = {_EXTRA + name: array for name, array in reference.extra.items()}
    with whole_file(Path(path), suffix=".npz") as temporary:
        np.savez(
            temporary,
            header=np.array(text),
            mesh=reference.mesh,
            points=reference.method.points,
            support=reference.method.support,
            states=reference.states,
            inputs=reference.inputs,
            **arrays,
        )


def _checked(header: Any, arrays: dict[str, Array]) -> Reference:
    """Make a reference of a file's parts; any of the raised errors means that the file is not one."""
    if header["format"] != FORMAT:
        raise ValueError(f"its format is {header['format']!r}")
    if header["version"] not in READ:
        raise ValueError(f"its version is {header['version']!r}, this program reads {' and '.join(map(str, READ))}")
    method = method_named(header["method"])
    mesh, states, inputs = (np.asarray(arrays[k], dtype=float) for k in ("mesh", "states", "inputs"))
    intervals, count = len(mesh) - 1, len(method.points)
    if not np.allclose(arrays["points"], method.points, rtol=0, atol=1e-12):
        raise ValueError(f"its points are not those of {method.name}")
    if "support" in arrays and not np.allclose(arrays["support"], method.support, rtol=0, atol=1e-12):
        raise ValueError(f"its states are not given where {method.name} has them")
    if intervals < 1 or not (np.diff(mesh) > 0).all():
        raise ValueError("its mesh does not rise")
    if states.shape[:2] != (intervals, count + 1) or inputs.shape[:2] != (intervals, count):
        raise ValueError(f"states {states.shape} and inputs {inputs.shape} do not fit its mesh")
    if states.ndim != 3 or inputs.ndim != 3 or not (np.isfinite(states).all() and np.isfinite(inputs).all()):
        raise ValueError("its states or inputs are not finite")
    numbers: dict[str, Any] = {k: np.inf if header["numbers"][k] is None else header["numbers"][k] for k in _NUMBERS}
    return Reference(
        mesh=mesh,
        method=method,
        states=states,
        inputs=inputs,
        limits=Limits(**header["limits"]),
        status=str(header["status"]),
        converged=bool(header["converged"]),
        extra=MappingProxyType({k[len(_EXTRA) :]: v for k, v in arrays.items() if k.startswith(_EXTRA)}),
        notes=MappingProxyType(dict(header["notes"])),
        **numbers,
    )


def load_reference(path: Path | IO[bytes]) -> Reference:
    """Read what `save_reference` wrote, from a path or an open binary file.

    Raises:
        InputError: there is no such file, or it is damaged or not a reference; says which.
    """
    making = {"make": "plan the itinerary first", "again": "plan again"}
    with archive(path, what="a reference", **making) as (header, arrays):
        return _checked(header, arrays)
