"""Results find their renderers through one table."""

import inspect
from importlib import import_module
from typing import get_type_hints

import pytest

from dpcontrol.foundation.errors import InputError
from dpcontrol.foundation.rendering import render
from dpcontrol.pages.renderers import PANELS, PARTS, RECORDINGS, RENDERERS, renderer


@pytest.mark.parametrize("table", [RENDERERS, PANELS, RECORDINGS])
def test_each_entry_of_a_table_names_a_class_and_a_function(table: dict[str, str]) -> None:
    for name, place in table.items():
        module, _, kind = name.rpartition(".")
        assert inspect.isclass(getattr(import_module(module), kind))
        assert inspect.isfunction(renderer(place))


@pytest.mark.parametrize(("name", "part"), PARTS.items())
def test_a_part_drawn_in_place_of_its_result_has_a_page_and_a_panel(name: str, part: str) -> None:
    module, _, kind = name.rpartition(".")
    result = getattr(import_module(module), kind)
    held = getattr(result, part, None)
    made = getattr(held, "func", None) or getattr(held, "fget", None)
    drawn = get_type_hints(made)["return"] if made else get_type_hints(result)[part]
    for table in (RENDERERS, PANELS):
        assert f"{drawn.__module__}.{drawn.__qualname__}" in table


def test_a_result_without_a_renderer_is_rejected_with_the_results_that_have_one() -> None:
    with pytest.raises(InputError, match=r"a dict has no picture; results with one are .*Night.*Run"):
        render({})
