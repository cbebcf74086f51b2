"""The guide's reference of the Python interface is that of the docstrings, which have the form that it needs."""

import inspect
import re

import pytest
from result_attributes import attributes, classes

import dpcontrol as dp
from tests.api_reference import CLASSES, FUNCTIONS, GROUPS, GUIDE, entry, page, results


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


@pytest.mark.parametrize("kind", classes(), ids=lambda kind: kind.__name__)
def test_the_docstrings_of_a_result_describe_every_public_attribute(kind: type) -> None:
    assert [name for name, text in attributes(kind).items() if not text] == []


def test_each_class_of_results_is_described_on_one_page() -> None:
    listed = [kind for stem in GROUPS for kind in results(stem)]
    assert len(set(listed)) == len(listed)
    assert {kind.__name__ for kind in listed} == {kind.__name__ for kind in classes()} - set(CLASSES)
