"""The way from a result to its picture, which a higher layer draws.

Results do not import the modules that draw them. They call `render`, which finds the renderer in the table
`dpcontrol.pages.renderers.RENDERERS`. This is the only module that imports a higher layer, and it does so by name.
`Axes`, `Figure` and `DataFrame` are those of matplotlib and pandas for type checkers, so that results can annotate
`plot` and `frame` without them.
"""

from contextlib import AbstractContextManager
from importlib import import_module
from typing import TYPE_CHECKING, Any

from dpcontrol.foundation.errors import InputError, shortened

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure
    from pandas import DataFrame as DataFrame
else:
    Axes = Figure = DataFrame = Any

_TABLE = "dpcontrol.pages.renderers"
_LIVE = "dpcontrol.pages.viewer"


def render(result: object, axes: Axes | None = None) -> Figure:
    """Return the picture of a result.

    Args:
        result: an instance of a class in the table of renderers, or of a subclass.
        axes: panel to draw in; by default a new figure is drawn.

    Returns:
        The new figure, or the figure of `axes`.

    Raises:
        InputError: the result has no renderer, its picture has several panels and does not fit in `axes`, or these
            are not plane and rectangular.
    """
    table = import_module(_TABLE)
    if axes is not None and getattr(axes, "name", "") != "rectilinear":
        raise InputError(f"axes = {shortened(axes)}: pictures need plane rectangular axes, as plt.subplots makes them")
    # The table has names of classes: those with a page (RENDERERS), those with one panel (PANELS), and those that are
    # drawn by one of their attributes (PARTS). The nearest base class in it counts.
    for kind in type(result).__mro__:
        name = f"{kind.__module__}.{kind.__qualname__}"
        if name in table.PARTS:
            return render(getattr(result, table.PARTS[name]), axes)
        if axes is not None and name in table.PANELS:
            table.renderer(table.PANELS[name])(axes, result)
            return axes.figure  # type: ignore[return-value]
        if name in table.RENDERERS:
            if axes is not None:
                raise InputError(f"the picture of a {kind.__name__} has several panels; plot it without axes")
            return table.renderer(table.RENDERERS[name])(result)
        if name in table.PANELS:
            return table.alone(result, table.PANELS[name])
    names = ", ".join(sorted(name.rpartition(".")[2] for name in (*table.RENDERERS, *table.PARTS)))
    raise InputError(f"a {type(result).__name__} has no picture; results with one are {names}")


def thumbnail(result: object) -> Figure:
    """Return a small picture of a result: its most important chart.

    Args:
        result: result with a renderer.

    Raises:
        InputError: the result has no chart that fits in one panel.
    """
    return render(result, import_module(_TABLE).new_axes(5.2, 3.6))


def live_view(start: Any) -> AbstractContextManager[Any]:
    """Return a sink for a closed loop that shows the run in the Rerun viewer while it lasts.

    Args:
        start: `RunLog` of the run before its first row.

    Raises:
        InputError: there is no viewer, or no display to open it on.
    """
    return import_module(_LIVE).LiveView(start)
