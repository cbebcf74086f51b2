"""The text of a result: entries of its JSON document, as lines and tables."""

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

from dpcontrol.foundation.document import document_of, plain
from dpcontrol.words.table import Line, TextTable

ENTRIES = {
    "Atlas": "model energy orbits:saddle,family,period,floquet_multipliers,residual "
    "transport:saddle,action,volume,mean_time,returns rotating_orbits:arm,period,kind,floquet_multipliers,residual "
    "kinds:from,to,section,hits,count,complete connections:name,transversality_angle_deg,symmetric,residual "
    "seconds file cached status",
    "BifurcationSearch": "from to section hits "
    "events:value,energy,kind,count_below,count_above,at_least,symmetric,winding,residual,state status",
    "CacheContents": "kinds status",
    "Campaign": "itinerary cases:case,runs,completed,success_rate,wilson_95,returned standard "
    "transitions:source,target,duration,case,runs,completed,max_cart_position,rms_cart_acceleration pairs "
    "failures:case,seed,symbol,cause simulated_seconds seconds file",
    "CampaignSummary": "campaign groups by_reason=failures.by_reason status",
    "CertificateCheck": "statement status",
    "ConnectionSearch": "from to energy section "
    "connections:name,sense,symmetric,transversality_angle_deg,residual,time_out,time_in open_cuts status",
    "Design": "unknowns best pair status",
    "Edges": "energy edges:name,sense,transversality_angle_deg walks_by_length absent notes",
    "Identification": "candidates parameters undetermined starting_model_left_out_rms file status",
    "LyapunovFamily": "saddle family:energy,period,floquet_multipliers,state events:kind,energy ends:energy,reason "
    "status",
    "LyapunovOrbit": "saddle energy period state floquet_multipliers residual status",
    "ModelDescription": "model title parameters equilibria:energy,kind,eigenvalues,need,spare_encoders sources "
    "differences mjcf file",
    "Night": "log hours uptime repetitions falls falls_per_hour causes return_median return_99 catches stop_hits "
    "max_cart_position rms_tracking_error memory_growth deadlines drift not_logged endings partials",
    "Plan": "walk wraps shadowing=shadowing.status duration=reference.duration "
    "max_cart_position=reference.max_cart_position rms_cart_acceleration=reference.rms_cart_acceleration "
    "max_cart_acceleration=reference.max_cart_acceleration file cached transfers:text,duration,effort,stroke "
    "polished=polish.status polished_file=polish.plan.file sides=polish.sides margins=margins.status "
    "energy_chosen=energies.chosen energies_file=energies.file warnings:cause,failed,status,remedy status",
    "Preflight": "itinerary advice notes warnings:status,remedy known endings:cause,share,seed "
    "borders:name,unit,set,border,low,high,margin changes:text,typed,gain,error,rescued,failing,lost,completing status",
    "ReferenceFile": "title file itinerary model plan duration intervals method shortest_interval longest_interval "
    "max_error_between_nodes measured_error_between_nodes rms_cart_acceleration effort limits symbols transitions "
    "status",
    "RefinedConnection": "name energy state residual correction status",
    "RotatingFamilies": "arm energies families:count=#members,status",
    "RotatingOrbits": "arm rotating_orbits:energy,period,kind,floquet_multipliers,residual,state status",
    "SolvedWalks": "energy walks least_seen notes film status",
    "SymmetricSearch": "from family connections:name,energy,winding,residual,time_out,state status",
}
"""Class of a result -> the shown entries of its document, as `KEYS` writes them; all for other classes."""
UNITS = {
    **dict.fromkeys(("code", "memory", "size", "stack", "tables", "tables_per_second"), "bytes"),
    **dict.fromkeys(
        ("effort_before", "effort_expected", "max_cart_acceleration", "rms_cart_acceleration", "u_max", "u_rms"), "m/s²"
    ),
    **dict.fromkeys(("energy", "energies"), "J"),
    **dict.fromkeys(("duration", "mean_time", "period", "seconds", "simulated_seconds", "time_in", "time_out"), "s"),
    "action": "J s",
    "max_cart_position": "m",
    "max_cart_velocity": "m/s",
    "need": "m/s² per rad",
    "rms_tracking_error": "rad",
    "state": "rad, rad/s",
    "volume": "J s²",
}
"""Units of entries of systems with SI units."""
_MOST = 100
"""Greatest number of rows of a table; `--json` has all."""
_CELL = 110
"""Longest text in a cell of a table."""
_LONG = 200
"""Number of characters of a text."""
_SENTENCES = ("statement", "status", "title")
"""Entries without a name before them."""


def listing(result: Any) -> Iterator[Line]:
    """Yield the entries of a result's document for the terminal: lines for single values, tables for rows.

    The entries are those in `ENTRIES` for the class of the result, all for a class that is not listed.

    Args:
        result: result of a public function.
    """
    document = plain(result.document() if hasattr(result, "document") else result)
    for kind in type(result).__mro__:
        if kind.__name__ in ENTRIES:
            document = document_of(document, ENTRIES[kind.__name__])
            break
    system = getattr(getattr(result, "source", result), "system", result)
    yield from _lines(document, UNITS if getattr(system, "si", True) else {})


def _lines(document: Mapping[str, Any], units: Mapping[str, str]) -> Iterator[Line]:
    """Yield the entries of a document as lines and tables, the status last; empty entries are left out.

    Rows, which are mappings, become a table, or a section for each row if a cell is too long for a table. Lists of
    sentences become a line for each sentence, and single values a line with the entry's name.

    Args:
        document: JSON values by key.
        units: units of the entries by key.
    """
    names = {key: _name(key, units) for key in document}
    width = max(map(len, names.values()), default=0)
    # The status, for which the comparison is True, comes last.
    for key in sorted(document, key="status".__eq__):
        value = document[key]
        rows = _rows(value)
        if value is None or value in ("", [], {}):
            continue
        cells = [cell for row in rows for cell in row.values()]
        # Tables and long texts have no room in a cell.
        if any(isinstance(cell, Mapping) or (isinstance(cell, str) and len(cell) > _CELL) for cell in cells):
            for number, row in enumerate(rows, start=1):
                yield f"{names[key]} {number}"
                yield from _lines(row, units)
        elif rows:
            yield _table(names[key], rows[:_MOST], units)
            yield from [f"… and {len(rows) - _MOST} more, which --json lists"] if len(rows) > _MOST else []
        elif sentences := _sentences(value):
            yield from (names[key], *(f"  {sentence}" for sentence in sentences))
        elif key in _SENTENCES:
            yield str(value)
        else:
            yield f"  {names[key]:<{width}}  {_text(value, 15)}"


def _name(key: str, units: Mapping[str, str]) -> str:
    """Return an entry's key as a name for people, with its unit."""
    return key.replace("_", " ") + (f" ({units[key]})" if key in units else "")


def _rows(value: Any) -> list[Mapping[str, Any]]:
    """Return the rows of a list of mappings, or of a mapping with a name for each row; none for other values.

    `value` is an entry of a JSON document.
    """
    if isinstance(value, Mapping) and all(isinstance(row, Mapping) for row in value.values()):
        return [{"name": name, **row} for name, row in value.items()]
    return value if isinstance(value, list) and all(isinstance(row, Mapping) for row in value) else []


def _sentences(value: Any) -> list[str]:
    """Return the texts of a list or mapping as lines, if at least one is a sentence; none for other values.

    `value` is an entry of a JSON document. A mapping gives each line the name of its text. A text with a blank counts
    as a sentence.
    """
    texts = list(value.values()) if isinstance(value, Mapping) else value
    is_prose = isinstance(texts, list) and all(isinstance(text, str) for text in texts)
    if not (is_prose and any(" " in text for text in texts)):
        return []
    prefixes = [f"{name}: " for name in value] if isinstance(value, Mapping) else [""] * len(texts)
    return [f"{prefix}{_text(text, 0)}" for prefix, text in zip(prefixes, texts, strict=True)]


def _table(title: str, rows: Sequence[Mapping[str, Any]], units: Mapping[str, str]) -> TextTable:
    """Return a table of rows, without columns that are empty in all rows.

    Args:
        title: title of the table.
        rows: values by key; the first row has all keys.
        units: units of the columns by key.
    """
    columns = [key for key in rows[0] if any(row.get(key) not in (None, [], "") for row in rows)]
    texts = [[_text(row.get(key), 10) for key in columns] for row in rows]
    return TextTable(title, [_name(key, units) for key in columns], texts)


def _text(value: Any, digits: int) -> str:
    """Return a value as text for people; a pair of numbers within a list is a complex number.

    Args:
        value: JSON value.
        digits: number of significant digits.
    """
    if value is None or isinstance(value, bool):
        return {None: "", True: "yes", False: "no"}[value]
    if isinstance(value, float):
        return f"{value:.1e}" if 0 < abs(value) < 1e-6 else f"{value:.{digits}g}"
    if isinstance(value, Mapping):
        return ", ".join(f"{key} {_text(part, 4)}" for key, part in value.items() if part is not None)
    if isinstance(value, list):
        return "  ".join(_complex(part, digits) if _is_pair(part) else _text(part, digits) for part in value)
    text = str(value)
    return text if len(text) <= _LONG else f"{text[:_LONG]}…"


def _is_pair(value: Any) -> bool:
    """Return True for a list of two floats, as complex numbers are written in documents."""
    return isinstance(value, list) and len(value) == 2 and all(isinstance(part, float) for part in value)


def _complex(parts: Sequence[float], digits: int) -> str:
    """Return a complex number as text; a part that is only a rounding error of the other is left out."""
    real, imaginary = (0.0 if abs(part) < 1e-12 * max(map(abs, parts)) else part for part in parts)
    if not imaginary:
        return f"{real:.{digits}g}"
    return f"{real:.{digits}g}{imaginary:+.{digits}g}i" if real else f"{imaginary:+.{digits}g}i"
