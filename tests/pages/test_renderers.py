"""Results find their renderers through one table."""

import inspect
from importlib import import_module

import pytest

from dpcontrol.pages.renderers import PANELS, RECORDINGS, RENDERERS, renderer


@pytest.mark.parametrize("table", [RENDERERS, PANELS, RECORDINGS])
def test_each_entry_of_a_table_names_a_class_and_a_function(table: dict[str, str]) -> None:
    for name, place in table.items():
        module, _, kind = name.rpartition(".")
        assert inspect.isclass(getattr(import_module(module), kind))
        assert inspect.isfunction(renderer(place))
