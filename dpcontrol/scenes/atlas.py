"""The atlas of an energy: orbits of all saddles, each tube cut once, all kinds of connection; kept by content.

Of two opposite kinds (a → b, b → a) one is searched, the other is its image under time reversal.
"""

import json
import time
from collections.abc import Callable
from dataclasses import asdict, dataclass, field
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from dpcontrol.dynamics.propagator import Section
from dpcontrol.dynamics.system import System
from dpcontrol.foundation.errors import InputError
from dpcontrol.foundation.files import content_hash
from dpcontrol.foundation.progress import Progress, no_progress
from dpcontrol.itineraries.atlas import Atlas, AtlasKind, AtlasPoint
from dpcontrol.scenes.atlas_file import load_atlas, save_atlas
from dpcontrol.scenes.atlas_records import (
    atlas_status,
    connection_record,
    cut_record,
    orbit_record,
    rotating_record,
    with_kind,
)
from dpcontrol.scenes.cache import cache_folder, code_hash
from dpcontrol.scenes.model import Model
from dpcontrol.tubes.connections import ConnectionSearch, find_connections
from dpcontrol.tubes.cut import Cut, tube_cut
from dpcontrol.tubes.equilibria import Equilibrium, equilibria
from dpcontrol.tubes.intersections import ConnectionSettings
from dpcontrol.tubes.lyapunov import LyapunovOrbit, lyapunov_orbit
from dpcontrol.tubes.manifold import UnstableManifold
from dpcontrol.tubes.reversal import can_be_reversed, reversed_search
from dpcontrol.tubes.rotating import can_rotate, rotating_orbits

Array = NDArray[np.float64]

FORMAT = 2
"""Raised whenever an atlas made by older code must not be taken for one made by this."""


@dataclass(frozen=True)
class AtlasSettings:
    """What an atlas holds.

    hits: of the unstable and the stable tube at every section; None means the first of both for each kind, and where
    these do not meet the next, up to last_hit. search: of each kind. strands: trajectories of each branch that are
    kept for drawing, and their instants.
    """

    hits: tuple[int, int] | None = None
    last_hit: int = 2
    strands: int = 40
    strand_instants: int = 160
    search: ConnectionSettings = field(default_factory=ConnectionSettings)

    def __post_init__(self) -> None:
        """Refuse what cannot be searched.

        Raises:
            InputError: the value and what is allowed.
        """
        if self.hits is not None and not all(1 <= hit <= 9 for hit in self.hits):
            raise InputError(f"hits = {list(self.hits)}: both must be from 1 to 9")


@dataclass(frozen=True)
class FoundAtlas:
    """An atlas, the file where it is kept, and whether it was found there."""

    atlas: Atlas
    file: Path
    cached: bool


def atlas_key(model: Model, energy: float, settings: AtlasSettings) -> str:
    """Return the content that an atlas depends on, as 16 hexadecimal digits."""
    content = {
        "format": FORMAT,
        "code": code_hash(__name__),
        "model": model.name,
        "parameters": model.system.parameters.tolist(),
        "system": type(model.parameters).__name__,
        "energy": energy,
        "settings": asdict(settings),
    }
    return content_hash(json.dumps(content, sort_keys=True))


def make_atlas(
    model: Model,
    energy: float,
    *,
    settings: AtlasSettings | None = None,
    fresh: bool = False,
    progress: Progress = no_progress,
) -> FoundAtlas:
    """Return the atlas of `model` at `energy` (J), from the cache unless `fresh`, and keep it there.

    Raises:
        InputError: no saddle has a Lyapunov orbit at this energy.
    """
    settings = settings or AtlasSettings()
    if not np.isfinite(energy):
        raise InputError(f"energy = {energy}: must be a finite number of joules")
    file = cache_folder("atlases") / f"{model.name}-{energy:g}-{atlas_key(model, energy, settings)}.npz"
    if not fresh and file.is_file():
        try:
            return FoundAtlas(load_atlas(file), file, cached=True)
        except InputError:
            # A damaged cache entry is replaced, as if it were not there.
            pass
    atlas = compute_atlas(model, energy, settings=settings, progress=progress)
    save_atlas(file, atlas)
    return FoundAtlas(atlas, file, cached=False)


def compute_atlas(
    model: Model, energy: float, *, settings: AtlasSettings | None = None, progress: Progress = no_progress
) -> Atlas:
    """Compute the atlas of `model` at `energy` (J).

    Raises:
        InputError: no saddle has a Lyapunov orbit at this energy.
    """
    settings = settings or AtlasSettings()
    system, seconds = model.system, {"orbits": 0.0, "tubes": 0.0, "connections": 0.0, "jit": 0.0}
    points = equilibria(system)
    saddles = [point for point in points.values() if point.kind.startswith("index-1")]
    progress("compiling", 0.0)
    with _timed(seconds, "jit"):
        _compile(system, [])
    progress("orbits", 0.1)
    with _timed(seconds, "orbits"):
        orbits, absent = _orbits(system, saddles, energy)
    if not orbits:
        births = ", ".join(f"{saddle.name} {saddle.energy:.6g} J" for saddle in saddles)
        raise InputError(
            f"energy = {energy:g} J: no saddle of {model.name} has a Lyapunov orbit; their families begin at {births}"
        )
    tubes = _Tubes(system, settings, seconds)
    # Sections are cut for the first of each saddle's families, which is the one that has sections.
    first = {orbit.saddle: orbit for orbit in orbits if orbit.family == 0}
    pairs = [pair for pair in system.sections if pair[0] in first and pair[1] in first]
    with _timed(seconds, "jit"):
        _compile(system, [system.sections[pair] for pair in pairs])
    searches: list[tuple[ConnectionSearch, AtlasKind]] = []
    for k, (source, target) in enumerate(pairs):
        low, high = 0.2 + 0.7 * k / len(pairs), 0.2 + 0.7 * (k + 1) / len(pairs)
        within: Progress = lambda what, done, low=low, high=high: progress(what, low + (high - low) * done)  # noqa: E731
        opposite = [s for s, kind in searches if (kind.target, kind.source) == (source, target)]
        symmetric = settings.hits is None or settings.hits[0] == settings.hits[1]
        if opposite and source != target and symmetric and can_be_reversed(system, source, target):
            searches += [with_kind(reversed_search(search), by_reversal=True) for search in opposite]
        else:
            searches += tubes.searches(first[source], first[target], within)
    progress("tubes", 0.9)
    with _timed(seconds, "tubes"):
        cuts = tuple(cut_record(tubes.manifold(first[saddle]), cut, settings.strands, settings.strand_instants)
                     for (saddle, _, _), cut in tubes.cuts.items())  # fmt: skip
    with _timed(seconds, "connections"):
        connections = tuple(connection_record(c) for search, _ in searches for c in search.connections)
    with _timed(seconds, "orbits"):
        samples = tuple(orbit_record(orbit) for orbit in orbits)
        progress("rotating orbits", 0.95)
        rotating = tuple(
            rotating_record(orbit)
            for arm in ((1, 2) if can_rotate(system) else ())
            for orbit in rotating_orbits(system, arm, energy)
        )
    kinds = tuple(kind for _, kind in searches)
    progress("atlas", 1.0)
    return Atlas(
        model=model.name,
        title=model.title,
        energy=energy,
        periods=system.periods,
        reverser=system.reversers[0],
        points=tuple(AtlasPoint(p.name, p.state, p.energy, p.kind) for p in points.values()),
        orbits=samples,
        rotating_orbits=rotating,
        absent=tuple(absent),
        cuts=cuts,
        kinds=kinds,
        connections=connections,
        seconds=seconds,
        status=atlas_status(orbits, absent, kinds, system),
    )


class _timed:
    """Add the seconds that a block takes to one entry."""

    def __init__(self, seconds: dict[str, float], key: str) -> None:
        self.seconds, self.key, self.began = seconds, key, 0.0

    def __enter__(self) -> None:
        self.began = time.perf_counter()

    def __exit__(self, *_: object) -> None:
        self.seconds[self.key] += time.perf_counter() - self.began


def _compile(system: System, sections: list[Section]) -> None:
    """Call each integrator once, for an instant: compiling is done on the first call."""
    # Off every section and every symmetry, where an event's derivatives do not vanish.
    off = 0.01 * np.arange(1, system.dimension + 1)
    state, instant = next(iter(system.equilibria.values())) + off * system.scale, 1e-6
    for section in dict.fromkeys(sections):
        system.propagator.crossing(state, section, longest=instant)
    if not sections:
        system.numeric.rate(state)
        system.propagator.flow(state, instant)
        system.propagator.flow_with_stm(state, instant)


def _orbits(
    system: System, saddles: list[Equilibrium], energy: float
) -> tuple[list[LyapunovOrbit], list[tuple[str, str]]]:
    """Return the orbits of all families at `energy`, and (saddle, reason) for those that are not there."""
    orbits: list[LyapunovOrbit] = []
    absent: list[tuple[str, str]] = []
    for saddle in saddles:
        centres = sum(value.imag > 1e-6 * abs(value) for value in saddle.eigenvalues)
        for family in range(centres):
            try:
                orbit = lyapunov_orbit(system, saddle.name, energy=energy, family=family)
            except InputError as error:
                absent.append((saddle.name, str(error)))
                break
            if orbit.converged:
                orbits.append(orbit)
            else:
                absent.append((saddle.name, f"the orbit of family {family} about {saddle.name} {orbit.status}"))
    return orbits, absent


class _Tubes:
    """Cuts tubes when they are first asked for, and searches their connections."""

    def __init__(self, system: System, settings: AtlasSettings, seconds: dict[str, float]) -> None:
        self.system, self.settings, self.seconds = system, settings, seconds
        self.cuts: dict[tuple[str, str, int], Cut] = {}
        self._manifolds: dict[str, UnstableManifold] = {}

    def manifold(self, orbit: LyapunovOrbit) -> UnstableManifold:
        if orbit.saddle not in self._manifolds:
            self._manifolds[orbit.saddle] = UnstableManifold(orbit, self.settings.search.distance)
        return self._manifolds[orbit.saddle]

    def cut(self, orbit: LyapunovOrbit, section: Section, hit: int) -> Cut:
        key = (orbit.saddle, section.name, hit)
        if key not in self.cuts:
            with _timed(self.seconds, "tubes"):
                self.cuts[key] = tube_cut(self.manifold(orbit), section, hit=hit, settings=self.settings.search.cut)
        return self.cuts[key]

    def searches(
        self, source: LyapunovOrbit, target: LyapunovOrbit, progress: Progress
    ) -> list[tuple[ConnectionSearch, AtlasKind]]:
        """Search one kind at its hits, or at the first hits at which there are any."""
        section, wanted = self.system.sections[source.saddle, target.saddle], self.settings.hits
        tried: list[tuple[ConnectionSearch, AtlasKind]] = []
        first = [(hit, hit) for hit in range(1, self.settings.last_hit + 1)]
        for hits in first if wanted is None else (wanted,):
            progress(f"tubes {source.saddle} → {target.saddle}", 0.0)
            cuts = (self.cut(source, section, hits[0]), self.cut(target, section, hits[1]))
            progress(f"connections {source.saddle} → {target.saddle}", 0.5)
            with _timed(self.seconds, "connections"):
                search = find_connections(
                    source,
                    target,
                    hits=hits,
                    settings=self.settings.search,
                    cuts=cuts,
                    progress=_upper_half(progress, source.saddle, target.saddle),
                )
            tried.append(with_kind(search, by_reversal=False))
            if search.connections:
                break
        return tried


def _upper_half(progress: Progress, source: str, target: str) -> Progress:
    report: Callable[[str, float], None] = lambda _, done: progress(f"connections {source} → {target}", 0.5 + done / 2)  # noqa: E731
    return report
