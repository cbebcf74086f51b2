"""The atlas of an energy: orbits of all saddles, one cut per tube, and all kinds of connection, cached by content.

On disk it is one .npz file, readable with numpy alone (`numpy.load(path)`), without pickles.

Arrays are float64 unless said otherwise. K and J count orbits, cuts, pieces and connections from 0. Keys:

    header   JSON text (a 0-d string array). Numbers have all their digits. Infinite or missing ones are null:
             {"format": "dpcontrol-atlas", "version": 2, "model", "title", "energy" (J), "status", "seconds",
              "points": [{name, state, energy, kind}], "absent": [[saddle, reason]],
              "sections": [{name, normal, position, momentum, offset, period, side, middle, reach}],
              "orbits": [{saddle, family, energy, period, state, floquet_multipliers: [[re, im]], residual, status}],
              "rotating_orbits": [{arm, winding, energy, period, state, floquet_multipliers, trace, kind, residual,
                                   status}],
              "cuts": [{saddle, section (index), hit, trajectories, resolved, status, open_ends,
                        pieces: [{branch, direction, closed}]}],
              "transport": [{saddle, energy, action, volume, returns, cause, si}],
              "kinds": [{source, target, section, hits, count, failed, complete, open_ends, by_reversal, status}],
              "connections": [{name, source, target, section (index), state, point, winding, sense, symmetric,
                               residual, transversality_angle (degrees), hits, time_out, time_in (s), phase_out,
                               phase_in}]}
    periods  (N,)      2π for angles, inf otherwise
    reverser (N, N)    maps unstable tubes to stable ones
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
import os
import time
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import MISSING, asdict, dataclass, field, fields, is_dataclass, replace
from io import BytesIO
from pathlib import Path
from typing import IO, Annotated, Any, get_args, get_type_hints

import numpy as np
from numpy.typing import NDArray

from dpcontrol.dynamics.propagator import Section
from dpcontrol.dynamics.system import System
from dpcontrol.foundation.arrays import Array
from dpcontrol.foundation.cache import cache_file, keep, kept
from dpcontrol.foundation.document import counted, fields_of, picked, plain
from dpcontrol.foundation.errors import InputError
from dpcontrol.foundation.files import archive, content_hash, write_archive
from dpcontrol.foundation.progress import Progress, no_progress, part_of
from dpcontrol.foundation.settings import Setting, Settings, adapter
from dpcontrol.orbits.cut import Cut, Piece, section_points
from dpcontrol.orbits.lyapunov import LyapunovOrbit, equilibria
from dpcontrol.orbits.manifold import UnstableManifold
from dpcontrol.orbits.orbit import OrbitRecord
from dpcontrol.orbits.rotating import RotatingOrbit, RotatingRecord, can_rotate, rotating_orbits
from dpcontrol.plans.model import Model
from dpcontrol.tubes.connections import Connection, ConnectionRecord
from dpcontrol.tubes.intersections import ConnectionSettings
from dpcontrol.tubes.transport import transport
from dpcontrol.walks.atlas import (
    Atlas,
    AtlasConnection,
    AtlasCut,
    AtlasKind,
    AtlasOrbit,
    AtlasPiece,
    AtlasPoint,
    AtlasRotatingOrbit,
)
from dpcontrol.walks.edges import PairSearch, TubeCuts, orbits_at, search_pairs

Arrays = dict[str, NDArray[Any]]

FORMAT = "dpcontrol-atlas"
VERSION = 2
SEARCHING = 2
"""Version of the searches, part of the cache keys: raise it whenever an atlas changes."""
_ORBIT_SAMPLES = 256
_FLIGHT_SAMPLES = 400
_DENSE = 4
"""Ratio of computed to stored instants."""


@dataclass(frozen=True)
class AtlasSettings(Settings, table="atlas"):
    """Contents of an atlas.

    Attributes:
        hits: crossings of the unstable and the stable tube at every section. None selects the first crossings of each
            kind that meet, up to last_hit.
        search: settings of each search.
        strands: number of stored trajectories of each branch, from which pages draw a tube.
        strand_instants: number of stored states of each of them.
    """

    hits: Annotated[tuple[int, int] | None, Setting(least=1, most=9)] = None
    last_hit: int = 2
    strands: int = 40
    strand_instants: int = 160
    search: ConnectionSettings = field(default_factory=ConnectionSettings)


def atlas_key(model: Model | System, energy: float, settings: AtlasSettings) -> str:
    """Return the hash of an atlas's inputs (16 hexadecimal digits), which is its key in the cache.

    Args:
        model: model, or a conservative system.
        energy: energy, J.
        settings: contents of the atlas.
    """
    content = {
        "format": VERSION,
        "code": SEARCHING,
        "model": model.name,
        "parameters": _system(model).parameters.tolist(),
        "system": model.description if isinstance(model, System) else type(model.parameters).__name__,
        "energy": energy,
        "settings": asdict(settings),
    }
    return content_hash(json.dumps(content, sort_keys=True))


def _system(model: Model | System) -> System:
    """Return the conservative system of a model, or the system itself."""
    return model if isinstance(model, System) else model.system


def make_atlas(
    model: Model | System,
    energy: float,
    *,
    settings: AtlasSettings | None = None,
    fresh: bool = False,
    yes: bool = False,
    progress: Progress = no_progress,
) -> Atlas:
    """Return a model's atlas at an energy, from the cache if possible.

    An atlas holds the equilibria, the Lyapunov orbits, the cuts of their tubes and the connections. It is cached unless
    a search of it ended early; its file is that in the cache.

    Args:
        model: model, or a conservative system.
        energy: energy, J.
        settings: contents of the atlas.
        fresh: True to ignore the cache.
        yes: accept any duration.
        progress: receiver of progress reports.

    Raises:
        InputError: no saddle has a Lyapunov orbit at this energy.
    """
    settings = settings or AtlasSettings()
    file = cache_file("atlases", f"{model.name}-{energy:g}", atlas_key(model, energy, settings))
    if not fresh and (content := kept(file)) is not None:
        return replace(load_atlas(BytesIO(content)), file=file, cached=True)
    atlas = compute_atlas(model, energy, settings=settings, yes=yes, progress=progress)
    if any(kind.partial for kind in atlas.kinds):
        return atlas
    content = BytesIO()
    save_atlas(content, atlas)
    keep(file, content.getvalue())
    return replace(atlas, file=file if os.path.isfile(file) else None)


def compute_atlas(
    model: Model | System,
    energy: float,
    *,
    settings: AtlasSettings,
    yes: bool = False,
    progress: Progress = no_progress,
) -> Atlas:
    """Compute the atlas of a model at an energy.

    Args:
        model: model, or a conservative system.
        energy: energy, J.
        settings: contents of the atlas.
        yes: accept any duration.
        progress: receiver of progress reports.

    Raises:
        InputError: no saddle has a Lyapunov orbit at this energy.
    """
    system, seconds = _system(model), {"orbits": 0.0, "tubes": 0.0, "connections": 0.0, "jit": 0.0}
    points = equilibria(system)
    saddles = [point for point in points.values() if point.kind.startswith("index-1")]
    progress("compiling", 0.0)
    with _timed(seconds, "jit"):
        _compile(system, [])
    progress("orbits", 0.1)
    with _timed(seconds, "orbits"):
        families = {point.name: sum(v.imag > 1e-6 * abs(v) for v in point.eigenvalues) for point in saddles}
        orbits, absent = orbits_at(system, families, energy)
    if not orbits:
        raise InputError("; ".join(dict.fromkeys(reason for _, reason in absent)))
    # Only the first of each saddle's families has sections to cut.
    first_orbits = {orbit.saddle: orbit for orbit in orbits if orbit.family == 0}
    kinds, connections, cuts = _connected(system, first_orbits, settings, seconds, yes=yes, progress=progress)
    with _timed(seconds, "orbits"):
        samples = tuple(_sampled_orbit(orbit) for orbit in orbits)
        progress("rotating orbits", 0.95)
        rotating = tuple(
            _sampled_rotating(orbit)
            for arm in ((1, 2) if can_rotate(system) else ())
            for orbit in rotating_orbits(system, arm, energy)
        )
    progress("atlas", 1.0)
    return Atlas(
        model=model.name,
        title=model.name if isinstance(model, System) else model.title,
        energy=energy,
        periods=system.periods,
        reverser=system.reversers[0],
        points=tuple(AtlasPoint(**fields_of(AtlasPoint, p)) for p in points.values()),
        orbits=samples,
        rotating_orbits=rotating,
        absent=tuple(absent),
        cuts=cuts,
        kinds=kinds,
        connections=connections,
        seconds=seconds,
        status=_status(orbits, absent, kinds, system),
        labels=system.labels,
        si=system.si,
        transport=tuple(transport(orbit) for orbit in orbits if system.dimension == 4),
    )


def _connected(
    system: System,
    orbits: Mapping[str, LyapunovOrbit],
    settings: AtlasSettings,
    seconds: dict[str, float],
    *,
    yes: bool,
    progress: Progress,
) -> tuple[tuple[AtlasKind, ...], tuple[AtlasConnection, ...], tuple[AtlasCut, ...]]:
    """Search for the connections between the orbits of one energy, and return all that an atlas stores of them.

    Args:
        system: system of the orbits.
        orbits: orbits of the first family, by saddle.
        settings: contents of the atlas.
        seconds: durations by stage, s, to which those of compilation, tubes and searches are added. The tubes are
            computed during the searches, and their time is subtracted.
        yes: accept any duration.
        progress: receiver of progress reports.

    Returns:
        Outcome of each search, samples of the connections, and samples of the cuts that the searches made.
    """
    pairs = [pair for pair in system.sections if pair[0] in orbits and pair[1] in orbits]
    with _timed(seconds, "jit"):
        _compile(system, [system.sections[pair] for pair in pairs])
    tubes = TubeCuts(system, settings.search)
    hits = [(hit, hit) for hit in range(1, settings.last_hit + 1)] if settings.hits is None else [settings.hits]
    with _timed(seconds, "connections"):
        portion = part_of(progress, 0.2, 0.9)
        searches = search_pairs(tubes, orbits, pairs, hits, until_found=True, yes=yes, progress=portion)
        connections = tuple(_sampled_connection(c) for result in searches for c in result.search.connections)
    seconds["tubes"], seconds["connections"] = tubes.seconds, seconds["connections"] - tubes.seconds
    progress("tubes", 0.9)
    with _timed(seconds, "tubes"):
        cuts = tuple(_sampled_cut(tubes.manifold(orbits[saddle]), cut, settings)
                     for (saddle, _, _), cut in tubes.cuts.items())  # fmt: skip
    return tuple(map(_kind, searches)), connections, cuts


@contextmanager
def _timed(seconds: dict[str, float], key: str) -> Iterator[None]:
    """Add the duration of a block (s) to the entry `key` of `seconds`."""
    begin = time.perf_counter()
    yield
    seconds[key] += time.perf_counter() - begin


def _compile(system: System, sections: list[Section]) -> None:
    """Compile each integrator by one short call, so that the durations of later stages do not include compilation.

    Without sections, the integrators of the flow are compiled, otherwise those of the sections' crossings.
    """
    # Off every section and every symmetry, where an event's derivatives do not vanish.
    offset = 0.01 * np.arange(1, system.dimension + 1)
    state, instant = next(iter(system.equilibria.values())) + offset * system.scale, 1e-6
    for section in dict.fromkeys(sections):
        system.propagator.crossing(state, section, longest=instant)
    if not sections:
        system.numeric.rate(state)
        system.propagator.flow(state, instant)
        system.propagator.flow_with_stm(state, instant)


def _sampled_orbit(orbit: LyapunovOrbit) -> AtlasOrbit:
    """Return the record of a Lyapunov orbit with samples at equally spaced phases."""
    samples = UnstableManifold(orbit).frame(np.arange(_ORBIT_SAMPLES) / _ORBIT_SAMPLES).states
    return AtlasOrbit(**fields_of(OrbitRecord, orbit), status=orbit.status, samples=samples)


def _sampled_rotating(orbit: RotatingOrbit) -> AtlasRotatingOrbit:
    """Return the record of a rotating orbit with samples at equally spaced phases."""
    times = np.arange(_ORBIT_SAMPLES) / _ORBIT_SAMPLES * orbit.period
    samples = orbit.system.propagator.sample(orbit.state, times)
    return AtlasRotatingOrbit(**fields_of(RotatingRecord, orbit), status=orbit.status, samples=samples)


def _sampled_connection(connection: Connection) -> AtlasConnection:
    """Return the record of a connection with its flight, extended by a period at each end, at evenly spread samples."""
    orbit, system = connection.orbit, connection.orbit.system
    begin, end = float(orbit.times[0]), float(orbit.times[-1])
    # A flight that never joins the orbit is shown whole.
    if np.isfinite(connection.time_out):
        begin = max(begin, -connection.time_out - connection.source.period)
    if np.isfinite(connection.time_in):
        end = min(end, connection.time_in + connection.target.period)
    dense_times = np.linspace(begin, end, _DENSE * _FLIGHT_SAMPLES)
    dense_states = orbit.sample(dense_times)
    rows = np.unique(_evenly(system, dense_times, dense_states, _FLIGHT_SAMPLES))
    return AtlasConnection(
        **fields_of(ConnectionRecord, connection),
        source=connection.source.saddle,
        target=connection.target.saddle,
        point=section_points(system, connection.section, connection.state),
        times=dense_times[rows],
        states=dense_states[rows],
        node_times=orbit.times,
        nodes=orbit.states,
    )


def _sampled_cut(manifold: UnstableManifold, cut: Cut, settings: AtlasSettings) -> AtlasCut:
    """Return the record of a tube's cut with trajectories of each branch, from which pages draw the tube.

    `manifold`: that of the tube's orbit. `settings`: number of the trajectories.
    """
    orbit, instants = manifold.orbit, settings.strand_instants
    system = orbit.system
    strands = [strand for branch in (1, -1) for strand in _strands(manifold, cut, branch, settings)]

    def piece(cut_piece: Piece) -> AtlasPiece:
        """Return the record of one piece of the cut, with the points of its time-reversed image on the stable tube."""
        reversed_states = (cut_piece.states - orbit.centre) @ orbit.reverser.T + orbit.centre
        return AtlasPiece(
            **fields_of(Piece, cut_piece), stable_points=section_points(system, cut.section, reversed_states)
        )

    return AtlasCut(
        saddle=orbit.saddle,
        pieces=tuple(piece(cut_piece) for cut_piece in cut.pieces),
        open_ends=tuple((end.branch, end.phase_interval, end.status) for end in cut.open_ends),
        **picked(cut, "section", "hit", "trajectories", "resolved", "status"),
        strands=np.array([states for _, _, states in strands]).reshape(-1, instants, system.dimension),
        strand_branches=np.array([branch for branch, _, _ in strands], dtype=np.int64),
        strand_phases=np.array([phase for _, phase, _ in strands], dtype=float),
    )


def _strands(
    manifold: UnstableManifold, cut: Cut, branch: int, settings: AtlasSettings
) -> Iterator[tuple[int, float, Array]]:
    """Yield trajectories of a tube that reach the section, spread evenly over the phases, for pictures of the tube.

    Each is the branch (±1), the phase of its seed, and its states (M, N) from the seed to the section. A seed is a
    state near the orbit, from which the trajectory leaves it; the cut holds the phases of seeds that reach the section.
    None are yielded for a branch that does not.
    """
    pieces = [piece for piece in cut.pieces if piece.branch == branch]
    if not pieces:
        return
    phases = np.concatenate([piece.phases for piece in pieces])
    times = np.concatenate([piece.times for piece in pieces])
    count, system = settings.strands, manifold.orbit.system
    nearest = [int(np.argmin(np.abs((phases - k / count + 0.5) % 1 - 0.5))) for k in range(count)]
    chosen_seeds = list(dict.fromkeys(nearest))
    for seed, k in zip(manifold.seeds(phases[chosen_seeds], branch)[0], chosen_seeds, strict=True):
        dense_times = np.linspace(0.0, times[k], _DENSE * settings.strand_instants)
        states = system.propagator.sample(seed, dense_times)
        yield branch, float(phases[k] % 1), states[_evenly(system, dense_times, states, settings.strand_instants)]


def _evenly(system: System, times: Array, states: Array, count: int) -> NDArray[np.int64]:
    """Return `count` indices of samples of a trajectory, spread evenly over half the time and half the scaled path.

    `times` (K,), s, and `states` (K, N) are those of the samples. So neither slow stretches near an orbit nor fast
    swings are short of samples.
    """
    path = np.r_[0.0, np.cumsum(np.linalg.norm(np.diff(states / system.scale, axis=0), axis=1))]
    progress_along = (times - times[0]) / (times[-1] - times[0]) + path / path[-1]
    return np.rint(
        np.interp(np.linspace(0.0, progress_along[-1], count), progress_along, np.arange(len(times)))
    ).astype(np.int64)


def _kind(result: PairSearch) -> AtlasKind:
    """Return the outcome of a search as an atlas stores it, without the connections themselves."""
    search = result.search
    return AtlasKind(
        source=result.pair[0],
        target=result.pair[1],
        section=search.cuts[0].section.name,
        hits=(search.cuts[0].hit, search.cuts[1].hit),
        count=len(search.connections),
        open_ends=tuple((tube, end.branch, end.phase_interval, end.status) for tube, end in search.open_ends),
        by_reversal=result.by_reversal,
        **picked(search, "failed", "complete", "status", "partial"),
    )


def _status(
    orbits: list[LyapunovOrbit], absent: list[tuple[str, str]], kinds: tuple[AtlasKind, ...], system: System
) -> str:
    """Return one sentence on existing, absent and possibly missed connections, which an atlas shows as its status."""
    count = sum(kind.count for kind in kinds)
    parts = [
        f"{counted(len(orbits), 'orbit')}, {counted(count, 'connection')} of "
        f"{counted(len({(k.source, k.target) for k in kinds}), 'kind')}"
    ]
    if not system.sections:
        parts.append(f"{system.name} has no sections for connections")
    later_hits = {(k.source, k.target): k.hits for k in kinds if k.count and k.hits != (1, 1)}
    empty_first_hits = {(k.source, k.target) for k in kinds if not k.count and k.hits == (1, 1)}
    for (source, target), hits in later_hits.items():
        if (source, target) in empty_first_hits:
            parts.append(f"{source} → {target} is empty at first hits and has its first connections at {list(hits)}")
    parts += [f"{k.source} → {k.target} has none at {list(k.hits)}" for k in kinds
              if not k.count and (k.source, k.target) not in later_hits]  # fmt: skip
    incomplete = [k for k in kinds if not k.complete]
    if incomplete:
        names = ", ".join(f"{k.source} → {k.target} at {list(k.hits)}" for k in incomplete)
        partial_note = ", as time ran out (partial)" if any(k.partial for k in incomplete) else ""
        parts.append(
            f"the searches of {names} are not complete{partial_note}: connections at these hits may be missing"
        )
    elif kinds:
        parts.append("all cuts are resolved, so none of these hits is missing down to the cuts' chord")
    parts += [reason for _, reason in absent]
    return "; ".join(parts)


def save_atlas(path: Path | BytesIO, atlas: Atlas) -> None:
    """Write an atlas to one .npz file, in the layout of the module's text, and as a whole or not at all.

    Args:
        path: file, or a file in memory.
        atlas: atlas to write.

    Raises:
        InputError: the file cannot be written.
    """
    arrays: Arrays = {}
    sections = list(dict.fromkeys(record.section for record in (*atlas.cuts, *atlas.connections)))
    header = {
        "format": FORMAT,
        "version": VERSION,
        "sections": [asdict(section) for section in sections],
        **_packed(atlas, "", arrays, sections),
    }
    write_archive(path, plain(header), arrays)


def _packed(record: Any, prefix: str, arrays: Arrays, sections: list[Section]) -> dict[str, Any]:
    """Return a record's entry in the header, and put its arrays into `arrays` under `prefix` and their names.

    `record` is an atlas or one of the dataclasses in it. Entries of a list "orbits" have the prefix "orbit_0_" and so
    on. A single state or point is in the header. An entry refers to a section by its index in `sections`.
    """
    entry: dict[str, Any] = {}
    for name, value in fields_of(type(record), record).items():
        if name in ("file", "cached"):
            continue
        if isinstance(value, Section):
            entry[name] = sections.index(value)
        elif isinstance(value, tuple) and value and is_dataclass(value[0]):
            item_prefix = f"{prefix}{name.removesuffix('s')}"
            entry[name] = [_packed(item, f"{item_prefix}_{k}_", arrays, sections) for k, item in enumerate(value)]
        elif isinstance(value, np.ndarray) and name not in ("state", "point") and not np.iscomplexobj(value):
            arrays[prefix + name] = value
        else:
            entry[name] = value
    return entry


def load_atlas(path: Path | IO[bytes]) -> Atlas:
    """Return the atlas that a file of `save_atlas` holds.

    Args:
        path: file, or an open binary file.

    Raises:
        InputError: the file does not exist, is damaged or is not an atlas.
    """
    remedies = {"make": "make one with `dpcontrol atlas MODEL --energy H`", "again": "make it again"}
    with archive(path, what="an atlas", **remedies, format=FORMAT, versions=(VERSION,)) as (header, arrays):
        # Any error here means that the file is not an atlas.
        for name, array in arrays.items():
            # Coordinates other than angles have an infinite period.
            if name != "periods" and not np.isfinite(array).all():
                raise ValueError(f"its array {name} is not finite")
        sections = [adapter(Section).validate_python(entry) for entry in header["sections"]]
        return adapter(Atlas).validate_python(_unpacked(Atlas, header, "", arrays, sections))


def _unpacked(
    kind: type, entry: dict[str, Any], prefix: str, arrays: Arrays, sections: list[Section]
) -> dict[str, Any]:
    """Return the values of a record's fields from its entry in the header, the inverse of `_packed`.

    Args:
        kind: class of the record.
        entry: its entry in the header.
        prefix: beginning of the names of its arrays.
        arrays: all arrays of the file by name.
        sections: sections to which entries refer by index.
    """
    values, hints = dict(entry), get_type_hints(kind)
    for attribute in fields(kind):
        name, hint = attribute.name, hints[attribute.name]
        item_kind = next((part for part in get_args(hint) if is_dataclass(part)), None)
        if name not in entry:
            # Fields with a default came later, and older files lack them.
            values |= {} if attribute.default is not MISSING else {name: arrays[prefix + name]}
        elif hint is Section:
            values[name] = sections[entry[name]]
        elif item_kind is not None:
            item_prefix = f"{prefix}{name.removesuffix('s')}"
            items = enumerate(entry[name])
            values[name] = [_unpacked(item_kind, part, f"{item_prefix}_{k}_", arrays, sections) for k, part in items]  # type: ignore[arg-type]
        elif name in ("state", "point"):
            values[name] = np.array(entry[name], dtype=float)
        elif name == "floquet_multipliers":
            values[name] = np.array([complex(*pair) for pair in entry[name]])
        elif hint is float and entry[name] is None:
            values[name] = np.nan
    return values
