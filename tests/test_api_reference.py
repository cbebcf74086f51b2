"""The guide's reference of the Python interface is that of the docstrings, which have the form that it needs."""

import inspect
import re

import pytest

import dpcontrol as dp
from tests.api_reference import CLASSES, FUNCTIONS, GROUPS, GUIDE, entry, page


@pytest.mark.slow
@pytest.mark.parametrize("stem", GROUPS)
def test_a_page_of_the_reference_is_generated_from_the_docstrings(stem: str) -> None:
    assert (GUIDE / f"{stem}.md").read_text(encoding="utf-8") == page(stem), "run python tests/api_reference.py"


def test_the_reference_has_every_function_once() -> None:
    listed = [name for _, names in GROUPS.values() for name in names]
    assert sorted(listed) == sorted([*FUNCTIONS, *CLASSES])


@pytest.mark.parametrize("name", FUNCTIONS)
def test_the_docstring_of_a_function_describes_every_argument(name: str) -> None:
    described = re.findall(r"^- \*\*(\w+)\*\* \(.*?\) – \S", entry(name), re.MULTILINE)
    assert described == list(inspect.signature(getattr(dp, name)).parameters)
