"""What the verbs of orbits, connections, walks and proofs print."""

from collections.abc import Iterator, Sequence
from typing import Any

from dpcontrol.foundation.document import counted
from dpcontrol.words.table import Line, TextTable, drawn_to, extended_text, multiplier_texts, spaced, table

_SHOWN = 8
"""Number of open ends of cuts to print: tubes that scatter have hundreds."""
_BRACKETS = " ({})"
_ROTATING = {
    "energy (J)": "{.energy:.9g}",
    "period (s)": "{.period:.12g}",
    "stability": "{.kind}",
    "multipliers": lambda o: multiplier_texts(o.floquet_multipliers, 8),
    "state (rad, rad/s)": lambda o: spaced(o.state, ".9f"),
}


def orbit(found: Any) -> Iterator[Line]:
    """Yield the period, the state and the multipliers of an orbit.

    Args:
        found: a `LyapunovOrbit`.
    """
    unit = found.system.unit
    yield f"Lyapunov orbit about {found.saddle} at {found.energy:g}{unit('J')}: {found.status}"
    yield f"  period       {found.period:.15g}{unit('s')}"
    yield f"  state        {spaced(found.state, '.15g')}{unit('rad, rad/s', '   ({})')}"
    yield f"  multipliers  {multiplier_texts(found.floquet_multipliers)}"
    yield f"  closure      {found.residual:.1e} (largest component of x(T) - x(0))"


def family(found: Any) -> Iterator[Line]:
    """Yield some twenty orbits of a family, and its ends.

    Args:
        found: a `LyapunovFamily`.
    """
    unit, members = found.system.unit, _some(found.members, 20)
    yield table(
        f"Lyapunov orbits about {found.saddle}, {len(members)} of {len(found.members)}",
        members,
        {
            f"energy{unit('J', _BRACKETS)}": "{.energy:.9g}",
            f"period{unit('s', _BRACKETS)}": "{.period:.9g}",
            "multipliers but the pair at one": lambda m: multiplier_texts(
                (v for v in m.floquet_multipliers if abs(abs(v) - 1) > 1e-3), 6
            ),
            f"state{unit('rad, rad/s', _BRACKETS)}": lambda m: spaced(m.state, ".6f"),
        },
    )
    for side, end in zip(("from", "to"), found.ends, strict=True):
        yield f"{side:5s}{end.energy:.9g}{unit('J')}: {end.status}"


def _some(members: Sequence[Any], count: int) -> Sequence[Any]:
    return members[:: max(1, len(members) // count)]


def rotating_orbits(found: Any) -> Iterator[Line]:
    """Yield the rotating orbits of an energy.

    Args:
        found: a `RotatingOrbits`.
    """
    name = found.orbits[0].system.name
    yield table(
        f"Orbits of {name} at {found.energy:g} J that turn the {found.arm} arm forward", found.orbits, _ROTATING
    )
    yield "each has a reflection that turns backward, (θ, ω) → (−θ, −ω), with the same multipliers"


def rotating_families(found: Any) -> Iterator[Line]:
    """Yield some orbits of each family, its changes of stability, folds and ends.

    Args:
        found: a `RotatingFamilies`.
    """
    for k, one in enumerate(found.families, start=1):
        members = _some(one.members, 12)
        title = f"Family {k} of {len(found.families)}, the {found.arm} arm turning"
        yield table(f"{title}: {len(members)} of {len(one.members)}", members, _ROTATING)
        for change in one.changes:
            yield f"  at {change.orbit.energy:.10g} J: from {change.before} to {change.after}"
        for fold in one.folds:
            yield f"  at {fold.energy:.10g} J the family turns back in energy"
        for side, end in zip(("from", "to"), one.ends, strict=True):
            yield f"  {side}: {end.status}"


def sustained(found: Any) -> Iterator[Line]:
    """Yield period, effort and multipliers of an orbit that the cart sustains.

    Args:
        found: a `SustainedOrbit`.
    """
    if not found.converged:
        return
    reference, lyapunov = found.reference, found.lyapunov
    yield f"Sustained orbit about {lyapunov.saddle} at {lyapunov.energy:g} J: {found.status}"
    yield f"  period       {found.period:.15g} s, {lyapunov.period:.15g} s without friction"
    yield f"  state        {spaced(found.state(0.0), '.9g')}   (rad, rad/s, m, m/s)"
    yield (
        f"  cart         {reference.rms_cart_acceleration:.4g} m/s² rms, {reference.max_cart_acceleration:.4g} "
        f"at most; {1e3 * reference.max_cart_position:.3g} mm at most"
    )
    yield f"  energy       {found.energies[0]:.6g} to {found.energies[1]:.6g} J along the orbit"
    by_section = found.section_multipliers(found.resets)
    for title, values in (("multipliers", found.multipliers), (f"by {found.resets} sections", by_section)):
        yield f"  {title:<12} {multiplier_texts(values, 9)}"
    yield "               the cart's are 1, 1: driven by its acceleration, nothing holds it in place"


def _symmetric(one: Any) -> str:
    return "yes" if one.symmetric else "pair"


def connections(found: Any, rows: Sequence[Any] | None = None) -> Iterator[Line]:
    """Yield the connections of a search, and the open ends of its cuts.

    Args:
        found: a `ConnectionSearch`.
        rows: connections to list; all of the search by default.
    """
    unit, source = found.source.system.unit, found.source
    out, into = (f"time {way}{unit('s', _BRACKETS)}" for way in ("out", "in"))
    yield table(
        f"{source.saddle} → {found.target.saddle} at {source.energy:g}{unit('J')} on {found.cuts[0].section.name}",
        found.connections if rows is None else rows,
        {
            "name": "{.name}",
            "sense": "{.sense:+d}",
            "symmetric": _symmetric,
            "angle (°)": "{.transversality_angle:.3f}",
            "residual": "{.residual:.0e}",
            out: "{.time_out:.4f}",
            into: "{.time_in:.4f}",
        },
    )
    yield found.status
    for tube, end in found.open_ends[:_SHOWN]:
        low, high = end.phase_interval
        yield f"open: {tube} tube, branch {end.branch:+d}, phase {low:.6f} … {high:.6f}: {end.status}"
    if len(found.open_ends) > _SHOWN:
        yield f"… and {len(found.open_ends) - _SHOWN} more open ends, which --json lists"


def chosen(found: Any) -> Iterator[Line]:
    """Yield a connection that was chosen by name.

    Args:
        found: a `ChosenConnection`.
    """
    yield from connections(found.search, found.connections)


def refined(found: Any) -> Iterator[Line]:
    """Yield the decimal digits of a refined connection.

    Args:
        found: a `RefinedConnection`.
    """
    connection, orbit = found.connection, found.refined
    place = f"{found.energy}{connection.source.system.unit('J')}"
    yield f"{connection.name} at {place} in 113-bit arithmetic: {orbit.status}"
    yield from extended_text(orbit.digits, "  ")
    yield f"  residual {found.residual} (largest gap between segments, in their units)"


def symmetric(found: Any) -> Iterator[Line]:
    """Yield the symmetric connections of a family.

    Args:
        found: a `SymmetricSearch`.
    """
    yield table(
        f"{found.saddle}, family {found.family}: symmetric homoclinics",
        found.connections,
        {
            "name": "{.name}",
            "energy (J)": "{.source.energy:.12g}",
            "turns": lambda c: ", ".join(map(str, c.winding)),
            "multiplier": "{.source.unstable_multiplier:.6g}",
            "residual": "{.residual:.0e}",
            "time out = in (s)": "{.time_out:.4f}",
            "middle (rad, rad/s)": lambda c: spaced(c.state, ".6f"),
        },
    )
    yield found.status


def bifurcations(found: Any) -> Iterator[Line]:
    """Yield the events of a search for bifurcations.

    Args:
        found: a `BifurcationSearch`.
    """
    unit, course = found.system.unit, found.course
    measured = _BRACKETS.format(course.unit.strip()) if course.unit else ""
    yield table(
        f"{found.source} → {found.target}, {counted(found.crossings, 'crossing')} of {found.section.name}",
        found.events,
        {
            f"{course.quantity}{measured}": "{.value:.10f}",
            f"energy{unit('J', _BRACKETS)}": "{.energy:.10f}",
            "kind": "{.kind}",
            "count": lambda e: f"{'at least ' if e.at_least else ''}{e.count_below} → {e.count_above}",
            "symmetric": _symmetric,
            "winding": lambda e: ", ".join(map(str, e.winding)),
            "residual": "{.residual:.0e}",
            f"state{unit('rad, rad/s', _BRACKETS)}": lambda e: spaced(e.state, ".6f"),
        },
    )
    yield found.status


def atlas(found: Any) -> Iterator[Line]:
    """Yield the orbits and connections of an atlas, and its file.

    Args:
        found: an `Atlas`.
    """
    yield table(
        f"{found.model} at {found.energy:g}{found.unit('J')}: Lyapunov orbits",
        found.orbits,
        {
            "about": "{.name}",
            f"period{found.unit('s', _BRACKETS)}": "{.period:.12g}",
            "multiplier": "{0.floquet_multipliers[0].real:.10g}",
            "closure": "{.residual:.0e}",
        },
    )
    yield _passages(found, found.transport)
    if found.rotating_orbits:
        yield _rotating_table(found)
    yield table(
        "connections",
        found.kinds,
        {
            "from → to": "{0.source} → {0.target}",
            "section": "{.section}",
            "hits": "{0.hits[0]}, {0.hits[1]}",
            "count": "{.count}",
            "cuts": lambda k: "closed" if k.complete else "open",
        },
    )
    for c in found.connections:
        also = ", symmetric" if c.symmetric else ""
        yield f"  {c.name}   {c.transversality_angle:.2f}°, residual {c.residual:.0e}{also}"
    yield found.status
    yield f"{', '.join(f'{name} {value:.2f} s' for name, value in found.seconds.items())} (when it was made)"
    partial = any(kind.partial for kind in found.kinds)
    nowhere = "none: a partial atlas is not cached; --out keeps it" if partial else "none: the cache cannot be written"
    yield f"file  {found.file or nowhere}{' (cached)' if found.cached else ''}"


def transport(found: Any) -> Iterator[Line]:
    """Yield the rates of passage through a neck.

    Args:
        found: a `Transport`.
    """
    yield _passages(found, [found])
    yield found.status


def _passages(found: Any, rates: Sequence[Any]) -> TextTable:
    return table(
        f"passages of the necks at {found.energy:g}{found.unit('J')}",
        rates,
        {
            "neck": "{.saddle}",
            f"action{found.unit('J s', _BRACKETS)}": "{.action:.6g}",
            f"volume{found.unit('J s²', _BRACKETS)}": "{.volume:.6g}",
            f"mean time{found.unit('s', _BRACKETS)}": "{.mean_time:.5g}",
            "return at once": lambda r: " ".join("-" if share is None else f"{share:.1%}" for share in r.returns),
        },
    )


def _rotating_table(found: Any) -> TextTable:
    return table(
        "orbits that turn one arm forward",
        found.rotating_orbits,
        {
            "arm": lambda o: ("inner", "outer")[o.arm - 1],
            "period (s)": "{.period:.12g}",
            "stability": "{.kind}",
            "multipliers": lambda o: multiplier_texts(o.floquet_multipliers, 8),
            "closure": "{.residual:.0e}",
        },
    )


def changes(found: Any) -> Iterator[Line]:
    """Yield the energies at which symbols select other connections.

    Args:
        found: a `SymbolChanges`.
    """
    yield from (one.sentence for one in found.changes)
    yield found.status


def graph(found: Any) -> Iterator[Line]:
    """Yield the connections of an energy, and the number of walks.

    Args:
        found: an `Edges`.
    """
    columns = {"from → to": "{0[0]} → {0[1]}", "count": lambda pair: str(len(found.between(*pair)))}
    yield table(f"connections at {found.energy:g}{found.system.unit('J')}", found.searched, columns)
    yield from (f"  {c.name}" for c in found.connections)
    counts = ", ".join(f"{length}: {count:,}" for length, count in found.walks_by_length.items())
    yield f"walks by number of symbols: {counts}"
    yield from (f"not there: {reason}" for _, reason in found.absent)
    yield from (f"perhaps more: {note}" for note in found.notes)


def walks(found: Any) -> Iterator[Line]:
    """Yield walks without their orbits.

    Args:
        found: a `WalkList`.
    """
    yield from ("  ".join(c.name for c in one.chain) for one in found.walks)
    count = len(found.walks)
    yield "1 walk; --solve finds its orbit" if count == 1 else f"{count} walks; --solve finds their orbits"


def solved(found: Any) -> Iterator[Line]:
    """Yield walks with their orbits, error estimates and files.

    Args:
        found: a `SolvedWalks`.
    """
    for number, answer in enumerate(found.answers, start=1):
        yield f"walk {number}: " + "  ".join(c.name for c in answer.request.chain)
        yield from _solution(answer) if answer.converged else [f"  {answer.status}"]
        yield from [] if answer.file is None else [f"  {answer.file}"]
    yield from drawn_to(found.film)
    yield found.status


def _solution(answer: Any) -> Iterator[Line]:
    """Yield the orbit of a walk and its error estimate."""
    orbit, estimate = answer.orbit, answer.orbit.estimate
    least = "" if answer.least is None else f" (least {_listing(answer.least)})"
    yield (
        f"  {'periodic, ' if orbit.periodic else ''}wraps {_listing(orbit.wraps_realised)}{least}, "
        f"{orbit.duration:.3f}{orbit.system.unit('s')}; {orbit.status}"
    )
    h = "not measured" if estimate.kantorovich is None else f"{estimate.kantorovich:.1e}"
    radius = "unknown, as h ≥ 1/2" if estimate.radius is None else f"{estimate.radius:.1e}"
    yield (
        f"  estimate: condition {estimate.condition:.1e}, Kantorovich h {h}, radius without rounding {radius}, "
        f"energy error {estimate.energy_error:.1e}"
    )
    if estimate.multipliers is not None:
        multipliers = estimate.multipliers
        yield (
            f"  multipliers: ±exp(±{multipliers.log_unstable:.9g}), sign {multipliers.sign:+d}, product off 1 by "
            f"{multipliers.reciprocity:.1e}"
        )
    if answer.refined is not None:
        yield f"  in 113-bit arithmetic: {answer.refined.status}; at the first symbol's section"
        yield from extended_text(answer.refined.digits, "    ")
        yield from [f"    period      {answer.refined.duration}"] if orbit.periodic else []


def _listing(wraps: Sequence[int]) -> str:
    return f"[{','.join(map(str, wraps))}]"


def proof(found: Any) -> Iterator[Line]:
    """Yield a statement with its verdict, enclosures and certificate.

    Args:
        found: a `Proof`.
    """
    yield found.statement
    yield f"  {found.status}"
    for name, value in found.figures.items():
        if isinstance(value, list) and value and isinstance(value[0], dict):
            yield from ("  " + ", ".join(f"{key} {one[key]}" for key in one) for one in value)
        elif value != []:
            shown = "  ".join(map(str, value)) if isinstance(value, list) else str(value)
            yield f"  {name.replace('_', ' '):<14} {shown}"
    yield f"  {found.seconds:.1f} s"
    if found.file is not None:
        yield f"  certificate    {found.file}"


def check(found: Any) -> Iterator[Line]:
    """Yield the verdict on a certificate.

    Args:
        found: a `CertificateCheck`.
    """
    yield f"checked: {found.status}" if found.proved else found.status
    yield from (f"  {one}" for one in (found.statement or "").splitlines())
