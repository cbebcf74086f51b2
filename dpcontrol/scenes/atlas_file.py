"""Atlases on disk: one .npz file, readable with numpy alone (`numpy.load(path)`), without pickles.

Keys; arrays are float64 unless said otherwise. K-th orbit, cut, piece and connection, counted from 0:

    header   JSON text (a 0-d string array), numbers with all their digits, null for what is not finite:
             {"format": "dpcontrol-atlas", "version": 2, "model", "title", "energy" (J), "status", "seconds",
              "points": [{name, state, energy, kind}], "absent": [[saddle, reason]],
              "sections": [{name, normal, position, momentum, offset, period, side}],
              "orbits": [{saddle, family, energy, period, state, floquet_multipliers: [[re, im]], residual, status}],
              "rotating_orbits": [{arm, winding, energy, period, state, floquet_multipliers, trace, kind, residual,
                                   status}],
              "cuts": [{saddle, section (index), hit, trajectories, resolved, status, open_ends,
                        pieces: [{branch, direction, closed}]}],
              "kinds": [{source, target, section, hits, count, failed, complete, open_ends, by_reversal, status}],
              "connections": [{name, source, target, section (index), state, point, winding, sense, symmetric,
                               residual, transversality_angle (degrees), hits, time_out, time_in (s), phase_out,
                               phase_in}]}
    periods  (N,)      2π for angles, inf otherwise;   reverser (N, N): turns unstable tubes into stable ones
    orbit_K_samples, rotating_orbit_K_samples     (M, N)  one period, equally spaced phases from 0
    cut_K_strands                          (B, M, N)  trajectories of the unstable tube, seed to section
    cut_K_strand_branches (int64), cut_K_strand_phases    (B,)
    cut_K_piece_J_phases, _times           (P,)    of the seeds; s of flight
    cut_K_piece_J_points, _stable_points   (P, 2)  (q, p/p₀) of the unstable tube, and of the stable one
    cut_K_piece_J_states                   (P, N)
    connection_K_times (F,), _states (F, N)             the flight; time 0 is at the section
    connection_K_node_times (L,), _nodes (L, N)         the nodes of the multiple shooting

States are angles, then rates (rad, rad/s), or positions and velocities.
"""

import json
import math
from dataclasses import fields
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dpcontrol.dynamics.propagator import Section
from dpcontrol.foundation.archives import archive
from dpcontrol.foundation.files import whole_file
from dpcontrol.itineraries.atlas import (
    Atlas,
    AtlasConnection,
    AtlasCut,
    AtlasKind,
    AtlasOrbit,
    AtlasPiece,
    AtlasPoint,
    AtlasRotatingOrbit,
)

FORMAT = "dpcontrol-atlas"
VERSION = 2
_IN_HEADER = ("state", "point")
"""Short arrays that stand in the header; the others are arrays of their own."""

Arrays = dict[str, NDArray[Any]]


def save_atlas(path: Path, atlas: Atlas) -> None:
    """Write `atlas` to `path` (whole, or not at all) in the layout above.

    Raises:
        InputError: the file cannot be written.
    """
    arrays: Arrays = {"periods": atlas.periods, "reverser": atlas.reverser}
    sections = list(dict.fromkeys([*(c.section for c in atlas.cuts), *(c.section for c in atlas.connections)]))
    header: dict[str, Any] = {
        "format": FORMAT,
        "version": VERSION,
        "model": atlas.model,
        "title": atlas.title,
        "energy": atlas.energy,
        "status": atlas.status,
        "seconds": dict(atlas.seconds),
        "absent": atlas.absent,
        "points": [_split(point, "", arrays, sections) for point in atlas.points],
        "sections": [_split(section, "", arrays, sections) for section in sections],
        "orbits": [_split(orbit, f"orbit_{k}_", arrays, sections) for k, orbit in enumerate(atlas.orbits)],
        "rotating_orbits": [
            _split(orbit, f"rotating_orbit_{k}_", arrays, sections) for k, orbit in enumerate(atlas.rotating_orbits)
        ],
        "cuts": [_split(cut, f"cut_{k}_", arrays, sections) for k, cut in enumerate(atlas.cuts)],
        "kinds": [_split(kind, "", arrays, sections) for kind in atlas.kinds],
        "connections": [
            _split(connection, f"connection_{k}_", arrays, sections) for k, connection in enumerate(atlas.connections)
        ],
    }
    text = json.dumps(_plain(header), allow_nan=False)
    with whole_file(Path(path), suffix=".npz") as temporary:
        np.savez(temporary, header=np.array(text), **arrays)  # type: ignore[arg-type]


def _split(record: Any, prefix: str, arrays: Arrays, sections: list[Section]) -> dict[str, Any]:
    """Return a record's entry in the header; its arrays go into `arrays` under `prefix` and their names."""
    entry: dict[str, Any] = {}
    for part in fields(record):
        value = getattr(record, part.name)
        if isinstance(value, Section):
            entry[part.name] = sections.index(value)
        elif part.name == "pieces":
            entry["pieces"] = [
                _split(piece, f"{prefix}piece_{k}_", arrays, sections) for k, piece in enumerate(record.pieces)
            ]
        elif isinstance(value, np.ndarray) and part.name not in _IN_HEADER and not np.iscomplexobj(value):
            arrays[prefix + part.name] = value
        else:
            entry[part.name] = value
    return entry


def _plain(value: Any) -> Any:
    """Return `value` in JSON's terms: arrays as lists, complex numbers as [re, im], what is not finite as null."""
    if isinstance(value, dict):
        return {key: _plain(item) for key, item in value.items()}
    if isinstance(value, np.ndarray):
        return _plain(value.tolist())
    if isinstance(value, list | tuple):
        return [_plain(item) for item in value]
    if isinstance(value, complex):
        return [value.real, value.imag]
    if isinstance(value, float):
        return float(value) if math.isfinite(value) else None
    return value


def load_atlas(path: Path) -> Atlas:
    """Read what `save_atlas` wrote.

    Raises:
        InputError: there is no such file, or it is damaged or not an atlas; says which.
    """
    making = {"make": "make one with `dpcontrol atlas MODEL --energy H`", "again": "make it again"}
    with archive(path, what="an atlas", **making) as (header, arrays):
        return _atlas(header, arrays)


def is_atlas(path: Path) -> bool:
    """Tell by its first bytes whether a file is a zip archive, as atlases are and logs are not."""
    try:
        with Path(path).open("rb") as file:
            return file.read(4) == b"PK\x03\x04"
    except OSError:
        return False


def _atlas(header: Any, arrays: Arrays) -> Atlas:
    """Make an atlas of a file's parts; any of the raised errors means that the file is not one."""
    if header["format"] != FORMAT:
        raise ValueError(f"its format is {header['format']!r}")
    if header["version"] != VERSION:
        raise ValueError(f"its version is {header['version']!r}, this program reads version {VERSION}")
    sections = [Section(**{key: _tuples(value) for key, value in entry.items()}) for entry in header["sections"]]
    size = len(arrays["periods"])

    def record(kind: Any, entry: dict[str, Any], prefix: str) -> Any:
        values: dict[str, Any] = {}
        for part in fields(kind):
            name = part.name
            if name not in entry:
                values[name] = _checked(arrays[prefix + name], prefix + name, size)
            elif name == "section" and isinstance(entry[name], int):
                values[name] = sections[entry[name]]
            elif name == "pieces":
                pieces = enumerate(entry[name])
                values[name] = tuple(record(AtlasPiece, piece, f"{prefix}piece_{k}_") for k, piece in pieces)
            elif name in _IN_HEADER:
                values[name] = np.array(entry[name], dtype=float)
            elif name == "floquet_multipliers":
                values[name] = np.array([complex(*pair) for pair in entry[name]])
            else:
                values[name] = float("nan") if entry[name] is None else _tuples(entry[name])
        return kind(**values)

    return Atlas(
        model=str(header["model"]),
        title=str(header["title"]),
        energy=float(header["energy"]),
        periods=arrays["periods"],
        reverser=_checked(arrays["reverser"], "reverser", size),
        points=tuple(record(AtlasPoint, entry, "") for entry in header["points"]),
        orbits=tuple(record(AtlasOrbit, e, f"orbit_{k}_") for k, e in enumerate(header["orbits"])),
        rotating_orbits=tuple(
            record(AtlasRotatingOrbit, e, f"rotating_orbit_{k}_") for k, e in enumerate(header["rotating_orbits"])
        ),
        absent=_tuples(header["absent"]),
        cuts=tuple(record(AtlasCut, e, f"cut_{k}_") for k, e in enumerate(header["cuts"])),
        kinds=tuple(record(AtlasKind, entry, "") for entry in header["kinds"]),
        connections=tuple(record(AtlasConnection, e, f"connection_{k}_") for k, e in enumerate(header["connections"])),
        seconds=dict(header["seconds"]),
        status=str(header["status"]),
    )


def _tuples(value: Any) -> Any:
    return tuple(_tuples(item) for item in value) if isinstance(value, list) else value


_LAST = {"points": 2, "stable_points": 2, "reverser": None, "samples": None, "strands": None, "states": None}
"""Length of the last axis by the end of an array's name; None: that of the state."""


def _checked(array: NDArray[Any], name: str, size: int) -> NDArray[Any]:
    """Return a finite array whose last axis has the length that its name asks for, or raise ValueError."""
    if not np.isfinite(array).all():
        raise ValueError(f"its array {name} is not finite")
    for ending, last in {**_LAST, "nodes": None}.items():
        if name == ending or name.endswith("_" + ending):
            wanted = size if last is None else last
            if array.ndim < 2 or array.shape[-1] != wanted:
                raise ValueError(f"its array {name} has shape {array.shape}, the last length must be {wanted}")
            break
    return array
