"""Figures in notebooks and in plain Python: each is displayed once. The command line takes no notice of either."""

from io import BytesIO

import pytest
from matplotlib import pyplot
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
