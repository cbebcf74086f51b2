"""Lines of plans."""

from collections.abc import Iterator
from typing import Any

from dpcontrol.words.table import Line, drawn_to, table


def plan(result: Any) -> Iterator[Line]:
    """Yield the plan and its requested additions, nothing without a reference.

    Args:
        result: a `Plan`.
    """
    if not result.converged:
        return
    reference, content = result.reference, result.content
    yield result.itinerary.title
    for symbol in content.symbols:
        named = f"{symbol.text!r} is {symbol.name}"
        yield f"  {named if symbol.name else f'{symbol.text}, a transfer at {symbol.time:.2f} s'}"
    if (residual := content.shadowing.residual) is not None:
        yield f"  shadowing orbit  {content.shadowing.duration:.3f} s, residual {residual:.1e}"
    yield f"  reference        {reference.status}"
    yield (
        f"  cart             {reference.max_cart_position * 1e3:.1f} mm at most, "
        f"{reference.rms_cart_acceleration:.3f} m/s² rms, {reference.max_cart_acceleration:.3f} m/s² at most"
    )
    yield f"{_file(result)}{' (cached)' if result.cached else ''}"
    yield from (f"  caution          {caution.status}: {caution.remedy}" for caution in result.warnings)
    if costs := content.costs:
        columns: dict[str, Any] = {
            "transfer": "{0.text}",
            "duration (s)": "{0.duration:.3g}",
            "∫u² (m²/s³)": "{0.effort:.3g}",
            "stroke (m)": "{0.stroke:.3g}",
        }
        yield table("", costs, columns)
    if result.polished is not None and result.polished.converged:
        yield from _polished(result.polished)
    if result.margins is not None:
        yield f"  margins          {result.margins.status}"
    if result.energies is not None:
        yield from (f"  energy           {result.energies.chosen}", *drawn_to(result.energies.file))


def _file(result: Any) -> str:
    return f"  file             {result.written or 'none: the cache cannot be written'}"


def _polished(result: Any) -> Iterator[Line]:
    yield f"  polished         {result.status}"
    yield _file(result.polished)
    columns: dict[str, Any] = {
        "plan": "{0.name}",
        "∫u² (m²/s³)": "{0.effort:.3g}",
        "peak (m/s²)": "{0.peak:.3g}",
        "travel (m)": "{0.travel:.3g}",
        "from the orbits": "{0.nearest:.2g}",
    }
    for mismatch in result.sides[0].completed:
        columns[f"completed at ±{mismatch:.0%}"] = lambda side, m=mismatch: "{0.successes} of {0.runs}".format(
            side.completed[m]
        )
    yield table("", result.sides, columns)
    yield "  The polished plan keeps crossings, windings and wraps; it need not come near the orbits."
