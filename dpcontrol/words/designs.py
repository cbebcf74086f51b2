"""Lines of orbits, connections, walks and proofs."""

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


def orbit(result: Any) -> Iterator[Line]:
    """Yield the period, the state and the multipliers of an orbit.

    Args:
        result: a `LyapunovOrbit`.
    """
    unit = result.system.unit
    yield f"Lyapunov orbit about {result.saddle} at {result.energy:g}{unit('J')}: {result.status}"
    yield f"  period       {result.period:.15g}{unit('s')}"
    yield f"  state        {spaced(result.state, '.15g')}{unit('rad, rad/s', '   ({})')}"
    yield f"  multipliers  {multiplier_texts(result.floquet_multipliers)}"
    yield f"  closure      {result.residual:.1e} (largest component of x(T) - x(0))"


def family(result: Any) -> Iterator[Line]:
    """Yield some twenty orbits of a family, and its ends.

    Args:
        result: a `LyapunovFamily`.
    """
    unit, members = result.system.unit, _some(result.members, 20)
    yield table(
        f"Lyapunov orbits about {result.saddle}, {len(members)} of {len(result.members)}",
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
    for side, end in zip(("from", "to"), result.ends, strict=True):
        yield f"{side:5s}{end.energy:.9g}{unit('J')}: {end.status}"


def _some(members: Sequence[Any], count: int) -> Sequence[Any]:
    return members[:: max(1, len(members) // count)]


def rotating_orbits(result: Any) -> Iterator[Line]:
    """Yield the rotating orbits of an energy.

    Args:
        result: a `RotatingOrbits`.
    """
    name = result.orbits[0].system.name
    yield table(
        f"Orbits of {name} at {result.energy:g} J that turn the {result.arm} arm forward", result.orbits, _ROTATING
    )
    yield "each has a reflection that turns backward, (θ, ω) → (−θ, −ω), with the same multipliers"


def rotating_families(result: Any) -> Iterator[Line]:
    """Yield some orbits of each family, its changes of stability, folds and ends.

    Args:
        result: a `RotatingFamilies`.
    """
    for k, member in enumerate(result.families, start=1):
        members = _some(member.members, 12)
        title = f"Family {k} of {len(result.families)}, the {result.arm} arm turning"
        yield table(f"{title}: {len(members)} of {len(member.members)}", members, _ROTATING)
        for change in member.changes:
            yield f"  at {change.orbit.energy:.10g} J: from {change.before} to {change.after}"
        for fold in member.folds:
            yield f"  at {fold.energy:.10g} J the family turns back in energy"
        for side, end in zip(("from", "to"), member.ends, strict=True):
            yield f"  {side}: {end.status}"


def sustained(result: Any) -> Iterator[Line]:
    """Yield period, effort and multipliers of an orbit that the cart sustains.

    Args:
        result: a `SustainedOrbit`.
    """
    if not result.converged:
        return
    reference, lyapunov = result.reference, result.lyapunov
    yield f"Sustained orbit about {lyapunov.saddle} at {lyapunov.energy:g} J: {result.status}"
    yield f"  period       {result.period:.15g} s, {lyapunov.period:.15g} s without friction"
    yield f"  state        {spaced(result.state(0.0), '.9g')}   (rad, rad/s, m, m/s)"
    yield (
        f"  cart         {reference.rms_cart_acceleration:.4g} m/s² rms, {reference.max_cart_acceleration:.4g} "
        f"at most; {1e3 * reference.max_cart_position:.3g} mm at most"
    )
    yield f"  energy       {result.energies[0]:.6g} to {result.energies[1]:.6g} J along the orbit"
    by_section = result.section_multipliers(result.resets)
    for title, values in (("multipliers", result.multipliers), (f"by {result.resets} sections", by_section)):
        yield f"  {title:<12} {multiplier_texts(values, 9)}"
    yield "               the cart's are 1, 1: driven by its acceleration, nothing holds it in place"


def _symmetric(connection: Any) -> str:
    return "yes" if connection.symmetric else "pair"


def connections(result: Any, rows: Sequence[Any] | None = None) -> Iterator[Line]:
    """Yield the connections of a search, and the open ends of its cuts.

    Args:
        result: a `ConnectionSearch`.
        rows: connections to list; all of the search by default.
    """
    unit, source = result.source.system.unit, result.source
    out, into = (f"time {way}{unit('s', _BRACKETS)}" for way in ("out", "in"))
    yield table(
        f"{source.saddle} → {result.target.saddle} at {source.energy:g}{unit('J')} on {result.cuts[0].section.name}",
        result.connections if rows is None else rows,
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
    yield result.status
    for tube, end in result.open_ends[:_SHOWN]:
        low, high = end.phase_interval
        yield f"open: {tube} tube, branch {end.branch:+d}, phase {low:.6f} … {high:.6f}: {end.status}"
    if len(result.open_ends) > _SHOWN:
        yield f"… and {len(result.open_ends) - _SHOWN} more open ends, which --json lists"


def chosen(result: Any) -> Iterator[Line]:
    """Yield a connection that was chosen by name.

    Args:
        result: a `ChosenConnection`.
    """
    yield from connections(result.search, result.connections)


def refined(result: Any) -> Iterator[Line]:
    """Yield the decimal digits of a refined connection.

    Args:
        result: a `RefinedConnection`.
    """
    connection, orbit = result.connection, result.refined
    place = f"{result.energy}{connection.source.system.unit('J')}"
    yield f"{connection.name} at {place} in 113-bit arithmetic: {orbit.status}"
    yield from extended_text(orbit.digits, "  ")
    yield f"  residual {result.residual} (largest gap between segments, in their units)"


def symmetric(result: Any) -> Iterator[Line]:
    """Yield the symmetric connections of a family.

    Args:
        result: a `SymmetricSearch`.
    """
    yield table(
        f"{result.saddle}, family {result.family}: symmetric homoclinics",
        result.connections,
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
    yield result.status


def bifurcations(result: Any) -> Iterator[Line]:
    """Yield the events of a search for bifurcations.

    Args:
        result: a `BifurcationSearch`.
    """
    unit, course = result.system.unit, result.course
    measured = _BRACKETS.format(course.unit.strip()) if course.unit else ""
    yield table(
        f"{result.source} → {result.target}, {counted(result.crossings, 'crossing')} of {result.section.name}",
        result.events,
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
    yield result.status


def atlas(result: Any) -> Iterator[Line]:
    """Yield the orbits and connections of an atlas, and its file.

    Args:
        result: an `Atlas`.
    """
    yield table(
        f"{result.model} at {result.energy:g}{result.unit('J')}: Lyapunov orbits",
        result.orbits,
        {
            "about": "{.name}",
            f"period{result.unit('s', _BRACKETS)}": "{.period:.12g}",
            "multiplier": "{0.floquet_multipliers[0].real:.10g}",
            "closure": "{.residual:.0e}",
        },
    )
    yield _passages(result, result.transport)
    if result.rotating_orbits:
        yield _rotating_table(result)
    yield table(
        "connections",
        result.kinds,
        {
            "from → to": "{0.source} → {0.target}",
            "section": "{.section}",
            "hits": "{0.hits[0]}, {0.hits[1]}",
            "count": "{.count}",
            "cuts": lambda k: "closed" if k.complete else "open",
        },
    )
    for c in result.connections:
        also = ", symmetric" if c.symmetric else ""
        yield f"  {c.name}   {c.transversality_angle:.2f}°, residual {c.residual:.0e}{also}"
    yield result.status
    yield f"{', '.join(f'{name} {value:.2f} s' for name, value in result.seconds.items())} (when it was made)"
    partial = any(kind.partial for kind in result.kinds)
    nowhere = "none: a partial atlas is not cached; --out keeps it" if partial else "none: the cache cannot be written"
    yield f"file  {result.file or nowhere}{' (cached)' if result.cached else ''}"


def transport(result: Any) -> Iterator[Line]:
    """Yield the rates of passage through a neck.

    Args:
        result: a `Transport`.
    """
    yield _passages(result, [result])
    yield result.status


def _passages(result: Any, rates: Sequence[Any]) -> TextTable:
    return table(
        f"passages of the necks at {result.energy:g}{result.unit('J')}",
        rates,
        {
            "neck": "{.saddle}",
            f"action{result.unit('J s', _BRACKETS)}": "{.action:.6g}",
            f"volume{result.unit('J s²', _BRACKETS)}": "{.volume:.6g}",
            f"mean time{result.unit('s', _BRACKETS)}": "{.mean_time:.5g}",
            "return at once": lambda r: " ".join("-" if share is None else f"{share:.1%}" for share in r.returns),
        },
    )


def _rotating_table(result: Any) -> TextTable:
    return table(
        "orbits that turn one arm forward",
        result.rotating_orbits,
        {
            "arm": lambda o: ("inner", "outer")[o.arm - 1],
            "period (s)": "{.period:.12g}",
            "stability": "{.kind}",
            "multipliers": lambda o: multiplier_texts(o.floquet_multipliers, 8),
            "closure": "{.residual:.0e}",
        },
    )


def changes(result: Any) -> Iterator[Line]:
    """Yield the energies at which symbols select other connections.

    Args:
        result: a `SymbolChanges`.
    """
    yield from (change.sentence for change in result.changes)
    yield result.status


def graph(result: Any) -> Iterator[Line]:
    """Yield the connections of an energy, and the number of walks.

    Args:
        result: an `Edges`.
    """
    columns = {"from → to": "{0[0]} → {0[1]}", "count": lambda pair: str(len(result.between(*pair)))}
    yield table(f"connections at {result.energy:g}{result.system.unit('J')}", result.searched, columns)
    yield from (f"  {c.name}" for c in result.connections)
    counts = ", ".join(f"{length}: {count:,}" for length, count in result.walks_by_length.items())
    yield f"walks by number of symbols: {counts}"
    yield from (f"not there: {reason}" for _, reason in result.absent)
    yield from (f"perhaps more: {note}" for note in result.notes)


def walks(result: Any) -> Iterator[Line]:
    """Yield walks without their orbits.

    Args:
        result: a `WalkList`.
    """
    yield from ("  ".join(c.name for c in walk.chain) for walk in result.walks)
    count = len(result.walks)
    yield "1 walk; --solve finds its orbit" if count == 1 else f"{count} walks; --solve finds their orbits"


def solved(result: Any) -> Iterator[Line]:
    """Yield walks with their orbits, error estimates and files.

    Args:
        result: a `SolvedWalks`.
    """
    for number, answer in enumerate(result.answers, start=1):
        yield f"walk {number}: " + "  ".join(c.name for c in answer.request.chain)
        yield from _solution(answer) if answer.converged else [f"  {answer.status}"]
        yield from [] if answer.file is None else [f"  {answer.file}"]
    yield from drawn_to(result.film)
    yield result.status


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


def proof(result: Any) -> Iterator[Line]:
    """Yield a statement with its verdict, enclosures and certificate.

    Args:
        result: a `Proof`.
    """
    yield result.statement
    yield f"  {result.status}"
    for name, value in result.figures.items():
        if isinstance(value, list) and value and isinstance(value[0], dict):
            yield from ("  " + ", ".join(f"{key} {line[key]}" for key in line) for line in value)
        elif value != []:
            shown = "  ".join(map(str, value)) if isinstance(value, list) else str(value)
            yield f"  {name.replace('_', ' '):<14} {shown}"
    yield f"  {result.seconds:.1f} s"
    if result.file is not None:
        yield f"  certificate    {result.file}"


def check(result: Any) -> Iterator[Line]:
    """Yield the verdict on a certificate.

    Args:
        result: a `CertificateCheck`.
    """
    yield f"checked: {result.status}" if result.proved else result.status
    yield from (f"  {line}" for line in (result.statement or "").splitlines())
