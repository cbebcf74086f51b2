"""Charts of a reference's mesh: interval lengths and errors between nodes."""

import numpy as np

from dpcontrol.foundation.arrays import Array
from dpcontrol.judge.run_view import RunView
from dpcontrol.pages import style
from dpcontrol.pages.chart import Chart, LevelLine, Line


def mesh_chart(view: RunView) -> Chart | None:
    if view.source is None:
        return None
    lengths = np.diff(view.source.mesh)
    title = f"Mesh: length of {len(lengths)} intervals of {view.source.method.name}"
    line = _stairs(view, lengths, style.REFERENCE)
    return Chart("", title, "s", (line,), shown=(0.0, 1.15 * float(lengths.max())))


def node_error_chart(view: RunView) -> Chart | None:
    if view.source is None:
        return None
    title = "Error between nodes, measured again (scaled)"
    if view.source.errors is None:
        return Chart("", f"{title}: the arms are not known", "", ())
    errors = view.source.errors
    shown = np.where(np.isfinite(errors), np.maximum(errors, 1e-17), np.nan)
    stored = view.source.max_error_between_nodes
    known = np.isfinite(stored) and stored > 0
    levels = (LevelLine("", "largest, as stored", stored, style.LIMIT, "named"),) if known else ()
    return Chart("", title, "", (_stairs(view, shown, style.REFERENCE),), levels=levels, log=True)


def _stairs(view: RunView, values: Array, colour: str) -> Line:
    """Return a line of one value for each mesh interval.

    Values are (I,), the mesh of the reference (I + 1,).
    """
    assert view.source is not None
    return Line("", "", "", np.repeat(view.source.mesh, 2)[1:-1], np.repeat(values, 2), colour, 1.1)
