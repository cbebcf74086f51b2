"""Statements of certificates, composed from their numbers.

`prove` writes the statement into a certificate. The independent check composes it again and compares the two. A
statement contains numbers that the check proves, and no names: a renamed certificate differs from its own numbers.
"""

from collections.abc import Iterable, Mapping, Sequence
from fractions import Fraction
from typing import Any

from dpcontrol.foundation.document import counted
from dpcontrol.proofs.balls import bound, decimal, flint, fraction, largest, number

EQUATIONS = {
    "double pendulum": (2, ("mass", "centre_of_mass", "length", "inertia", "gravity")),
    "three bodies": (0, ("mass_ratio",)),
}
"""Number of angles and parameters of each system of equations."""


def energies_stated(middle: Fraction, within: Fraction) -> str:
    """Return the words on the energies that a statement holds for, one energy or an interval.

    Args:
        middle: an energy.
        within: largest distance from it.
    """
    if not within:
        return f"the energy {_exact(middle)}"
    return f"each energy from {_exact(middle - within)} to {_exact(middle + within)}"


def interval(data: Mapping[str, Any]) -> tuple[Fraction, Fraction]:
    """Return the least and the greatest energy that a certificate covers.

    Args:
        data: content of the certificate by key.
    """
    middle, within = fraction(data["energy"]), fraction(data.get("within", 0))
    return middle - within, middle + within


def passing(count: int) -> str:
    """Return the words on an orbit that Newton–Kantorovich proves.

    Args:
        count: number of its sections.
    """
    return f"closes after passing its {count} sections once, in order"


def statement(data: Mapping[str, Any]) -> str:
    """Return the statement that a certificate proves, composed from its numbers, a sentence per line.

    Args:
        data: content of the certificate by key.

    Raises:
        ValueError: a value is no number.
        LookupError: a value is missing.
    """
    if "pieces" in data:
        (low, _), *_, (_, high) = map(interval, data["pieces"])
        count = counted(len(data["pieces"]), "interval")
        line = f"each energy from {_exact(low)} to {_exact(high)} is in one of {count}, with these statements"
        return "\n".join([line, *(piece["statement"] for piece in data["pieces"])])
    angles, keys = EQUATIONS[data["system"]["equations"]]
    if "links" in data:
        return "\n".join([*_network(data, angles), *_parameters(data, keys)])
    unique, exists, least = (_exact(data[key]) for key in ("unique", "exists", "multiplier_exceeds"))
    turns_in_words = ", ".join(str(int(k)) for k in data["turns"][:angles])
    return "\n".join(
        [
            f"at {_energies(data)}, exactly one orbit of the {data['system']['equations']} "
            f"{passing(len(data['nodes']))}, within {unique} of the nodes and of the flight times",
            f"it is within {exists} of them and closes after {_sum(data['durations'])} time units"
            + f", with the turns {turns_in_words} of its angles" * bool(angles),
            f"it starts near {_state(map(number, data['nodes'][0]))} and is hyperbolic: a multiplier exceeds {least} "
            "in modulus",
            *(_symbol(data, k, angles) for k in range(len(data["symbols"]))),
            *_parameters(data, keys),
        ]
    )


def _parameters(data: Mapping[str, Any], keys: Sequence[str]) -> list[str]:
    """Return the line on the parameters with these keys of the system in a certificate's content."""
    return ["parameters: " + "; ".join(f"{key} {', '.join(map(_exact, data['system'][key]))}" for key in keys)]


def _network(data: Mapping[str, Any], angles: int) -> list[str]:
    """Return the sentences on a network of orbits and of links, the chains of boxes that lead from orbit to orbit.

    `data` is the certificate's content by key, and `angles` the number of coordinates that turn.
    """
    orbits = counted(len(data["orbits"]), "ring")
    lines = [
        f"at {_energies(data)}, each of {orbits} of boxes contains exactly one orbit of the "
        f"{data['system']['equations']} that stays in it; it is periodic and hyperbolic"
    ]
    for k, orbit in enumerate(data["orbits"], start=1):
        lines.append(
            f"orbit {k} is in {len(orbit['charts'])} boxes of half-widths up to {_widest(orbit)} about "
            f"{_state(map(number, orbit['charts'][0]['node']))} and on, with a period near {_sum(orbit['durations'])}"
        )
    for k, link in enumerate(data["links"], start=1):
        turns_in_words = ", ".join(str(int(v)) for v in link["turns"][:angles])
        lines.append(
            f"link {k}: an orbit leads from orbit {int(link['source']) + 1} to orbit {int(link['target']) + 1}"
            + f", with the turns {turns_in_words} of its angles" * bool(angles)
            + f", in boxes of half-widths up to {_widest(link)}"
        )
        lines += [_crossed(link, j, angles) for j in range(len(link["symbols"]))]
        if "wraps" in data:
            places = (_number(link[key]) for key in ("time_out", "phase_out", "time_in", "phase_in"))
            lines.append("it departs {} before at the phase {} and arrives {} after at the phase {}".format(*places))
    if "wraps" in data:
        lines += [
            "every sequence of these links in which each leaves the orbit that the one before joins, finite, infinite "
            f"or periodic, with any numbers of at least {int(data['wraps'])} wraps at the stops, is followed by an "
            "orbit, by a closed one if sequence and wraps are periodic",
            "with N wraps, the next crossing follows after arrival + departure + (N + phase) T within T/2, where T is "
            "the period of the orbit, and the phase is that of departure minus that of arrival modulo one",
            "no other link or orbit passes the box of a link's crossing, so orbits of different sequences separate, "
            f"and the topological entropy is at least {_exact(data['entropy'])} per time unit",
        ]
    return lines


def _crossed(link: Mapping[str, Any], k: int, angles: int) -> str:
    """Return the sentence on symbol `k` of a link, counted from zero: its section crossings, state and next stop.

    `angles` is the number of coordinates that turn.
    """
    claim, charts = link["symbols"][k], link["charts"]
    first, second = map(int, claim["hits"])
    sentence = (
        f"it crosses the section {_section(claim['section'])} {counted(first + second - 1, 'time')}; crossing {first} "
        f"is in the box about {_state(map(number, charts[int(claim['node']) - 1]['node']))}"
    )
    if len(claim["states"]) > 1:
        nearest, *others = claim["states"]
        sentence += (
            f", nearer to {_state(_lifted(nearest, claim['turns']))} than to {counted(len(others), 'other state')}"
        )
    stop = _state(_lifted(claim["stop"], claim["stop_turns"])[:angles])
    return (
        sentence
        + f"; then its angles are within half a turn of {stop}" * bool(angles)
        + (f", and the next crossing follows after a time nearest to {_rest(claim)}" if "wraps" in claim else "")
    )


def _widest(data: Mapping[str, Any]) -> str:
    """Return the largest half-width of the boxes of an orbit or link, rounded up."""
    return bound(number(max(fraction(v) for row in data["widths"] for v in row)))


def _number(value: Any) -> str:
    """Return an integer or a decimal, as certificates hold it, with seven digits."""
    return f"{float(fraction(value)):.7g}"


def _sum(values: Iterable[Any]) -> str:
    """Return the sum of decimals with seven digits."""
    return _number(sum(map(fraction, values)))


def _rest(claim: Mapping[str, Any]) -> str:
    """Return the time after which the next symbol follows, as that without wraps plus wraps times the period."""
    return f"{_number(claim['rest'])} + {int(claim['wraps'])} · {_number(claim['period'])}"


def _symbol(data: Mapping[str, Any], k: int, angles: int) -> str:
    """Return the sentence on symbol `k` of a closed walk, counted from zero: its stops, crossings, node and wraps.

    `data` is the certificate's content by key, and `angles` the number of coordinates that turn. A claim of `symbols`
    has the entries that `check_symbols` lists.
    """
    claims, count = data["symbols"], len(data["nodes"])
    claim, before, after = claims[k], claims[k - 1], claims[(k + 1) % len(claims)]
    first, second = map(int, claim["hits"])
    nearest, *other_states = claim["states"]
    node, next_node = int(claim["node"]), int(after["node"]) + count * (k + 1 == len(claims))
    stay = _sum(data["durations"][i % count] for i in range(node, next_node))
    first_angles, last_angles = (
        _state(_lifted(place["stop"], turns)[:angles])
        for place, turns in ((before, claim["turns"]), (claim, claim["stop_turns"]))
    )
    return (
        f"symbol {k + 1}: "
        + f"from within half a turn of the angles {first_angles} to within half a turn of {last_angles}, "
        * bool(angles)
        + f"it crosses the section {_section(claim['section'])} {counted(first + second - 1, 'time')}; at crossing "
        f"{first}, node {node + 1} is within {_distance(data, claim)} of {_state(map(number, nearest))}"
        + f", nearer than to {counted(len(other_states), 'other state')}" * bool(other_states)
        + f"; the next symbol's node follows after {stay}, nearest to {_rest(claim)}"
    )


def _energies(data: Mapping[str, Any]) -> str:
    """Return the words on a certificate's energies; the boxes of an interval move with the energy."""
    words = energies_stated(fraction(data["energy"]), fraction(data.get("within", 0)))
    return words + ", with boxes that move with it" * ("within" in data and "links" in data)


def _exact(value: Any) -> str:
    """Return an integer or a decimal with all its digits."""
    return decimal(fraction(value)).lower()


def _lifted(state: Sequence[Any], turns: Sequence[Any]) -> list[Any]:
    """Return a state (N,) of decimals with whole turns (N,) added, as balls."""
    return [number(x) + 2 * flint.arb.pi() * int(k) for x, k in zip(state, turns, strict=True)]


def _state(values: Iterable[Any]) -> str:
    """Return the midpoints of a state (N,) of balls in brackets, with four decimals."""
    # Adding zero turns -0.0 into 0.0.
    return f"({', '.join(f'{round(float(v.mid()), 4) + 0.0:.4f}' for v in values)})"


def _distance(data: Mapping[str, Any], claim: Mapping[str, Any]) -> str:
    """Return an upper bound of the scaled distance of a symbol's node from its connection."""
    pairs = zip(
        _lifted(claim["states"][0], claim["turns"]), data["nodes"][int(claim["node"])], data["scale"], strict=True
    )
    return bound(largest([(x - number(c)) / number(s) for x, c, s in pairs]) + number(data["exists"]))


def _section(section: Mapping[str, Any]) -> str:
    """Return a section's equation in the coordinates x1 … x4, with its condition if there is one."""
    normal, side = (
        " + ".join(f"{_exact(v)} x{i}" for i, v in enumerate(section[key], start=1) if fraction(v))
        for key in ("normal", "side")
    )
    period = "2 pi" if section["period"] == "2 pi" else _exact(section["period"])
    middle, reach = _exact(section["middle"]), section["reach"]
    condition = f" where {side} > {middle}" if reach is None else f" where |{side} - {middle}| > {_exact(reach)}"
    return f"{normal} = {_exact(section['offset'])} + {period} k" + condition * bool(side)
