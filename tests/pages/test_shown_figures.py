"""Figures in notebooks and in plain Python: each is displayed once. The command line takes no notice of either."""

import os
import sys
from io import BytesIO
from pathlib import Path
from types import ModuleType, SimpleNamespace

import matplotlib as mpl
import pytest
from command_line import dpcontrol_program
from matplotlib import pyplot
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from PIL import Image

from dpcontrol.pages.layout import new_figure


@pytest.fixture
def page() -> Figure:
    """A figure as every page begins."""
    figure = new_figure(4.0, 2.0)
    figure.suptitle("costs 3$ and 4$")
    figure.add_subplot().plot([0, 1])
    return figure


def test_a_notebook_draws_a_page_as_the_value_of_its_cell(page: Figure) -> None:
    picture = Image.open(BytesIO(page._repr_png_()))
    assert picture.size == (4 * page.dpi, 2 * page.dpi)
    assert len(picture.convert("RGB").getcolors(10**6) or []) > 10
    # The inline backend would draw figures of pyplot again at the end of the cell.
    assert not pyplot.get_fignums()


def test_show_in_a_notebook_displays_the_page_once(page: Figure, monkeypatch: pytest.MonkeyPatch) -> None:
    displayed: list[Figure] = []
    shell = SimpleNamespace(kernel=object())
    notebook = SimpleNamespace(get_ipython=lambda: shell, display=SimpleNamespace(display=displayed.append))
    monkeypatch.setitem(sys.modules, "IPython", notebook)
    page.show()
    assert displayed == [page]
    assert not pyplot.get_fignums()


def test_show_in_plain_python_opens_one_window_of_the_page(page: Figure, monkeypatch: pytest.MonkeyPatch) -> None:
    windows: list[list[Figure]] = []
    backend = ModuleType("windows_for_tests")
    backend.FigureCanvas = FigureCanvasAgg
    backend.show = lambda **_: windows.append([pyplot._pylab_helpers.Gcf.get_active().canvas.figure])
    monkeypatch.setitem(sys.modules, backend.__name__, backend)
    before = mpl.get_backend()
    pyplot.switch_backend(f"module://{backend.__name__}")
    try:
        page.show()
        assert windows == [[page]]
        assert len(pyplot.get_fignums()) == 1
    finally:
        pyplot.close("all")
        pyplot.switch_backend(before)


@pytest.mark.slow
@pytest.mark.parametrize("backend", ["module://matplotlib_inline.backend_inline", "bogus"])
def test_the_command_line_draws_whatever_backend_a_notebook_has_chosen(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, backend: str
) -> None:
    monkeypatch.setenv("MPLBACKEND", backend)
    ended = dpcontrol_program("identify", "--design", "--picture", "design.png", folder=tmp_path)
    assert ended.code == 0, ended.stderr
    assert Image.open(tmp_path / "design.png").size[0] > 500
    assert os.environ["MPLBACKEND"] == backend
