"""Benchmarks in a small size: the same checks except for time, with little of the work.

`small_sizes.py` lists the small sizes. Small sizes are slow tests, so a broken benchmark is detected at once.
"""

import importlib
import importlib.util
import inspect
import subprocess
import sys
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager, nullcontext, redirect_stderr, redirect_stdout
from dataclasses import dataclass, field
from functools import cache
from io import StringIO
from pathlib import Path
from types import ModuleType, SimpleNamespace
from typing import Any

import pytest
from small_sizes import IN_SMALL, SIZES, WITHOUT, Small

TESTS = Path(__file__).parents[1]


@dataclass
class Made:
    """Values of fixtures whose scope is a module or a session, made once for all small sizes."""

    stack: ExitStack
    values: dict[tuple[str, str], Any] = field(default_factory=dict)


@pytest.fixture(scope="module")
def shared() -> Iterator[Made]:
    with ExitStack() as stack:
        yield Made(stack)


@pytest.mark.slow
@pytest.mark.parametrize("small", SIZES, ids=str)
def test_a_benchmark_checks_in_a_small_size_all_but_time(
    small: Small, shared: Made, request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch
) -> None:
    module = module_of(small)
    function = getattr(module, small.function)
    for name, value in small.constants.items():
        # A constant of another name would leave the whole work to be done.
        monkeypatch.setattr(*((name,) if "." in name else (module, name)), value, raising=True)
    for name, text in small.environment.items():
        monkeypatch.setenv(name, text)
    missing = [mark.kwargs["reason"] for mark in marks(module, function, "skipif") if mark.args[0]]
    if missing:
        pytest.skip(missing[0])
    printed = StringIO()
    with ExitStack() as stack:
        fixtures = Fixtures(small, module, request, shared, stack)
        fixtures.use_automatic_ones()
        values = {name: fixtures.value(name) for name in inspect.signature(function).parameters}
        try:
            with redirect_stdout(printed), redirect_stderr(printed):
                function(**values)
        finally:
            sys.stdout.write(printed.getvalue())
    text = printed.getvalue()
    assert bool(text) == bool(small.prints), "a small size states what its benchmark prints"
    for line in small.prints:
        assert line in text


def module_of(small: Small) -> ModuleType:
    """Return a module of tests by its file. As pytest does, add its folder to the path."""
    file = TESTS / f"{small.module}.py"
    if str(file.parent) not in sys.path:
        sys.path.insert(0, str(file.parent))
    return importlib.import_module(file.stem)


@cache
def conftest_of(folder: Path) -> ModuleType | None:
    """Return the module of a folder's own fixtures, or None."""
    file = folder / "conftest.py"
    if folder == TESTS or not file.exists():
        return None
    described = importlib.util.spec_from_file_location(f"fixtures_of_{folder.name}", file)
    assert described is not None
    assert described.loader is not None
    module = importlib.util.module_from_spec(described)
    described.loader.exec_module(module)
    return module


def marks(module: ModuleType, function: Any, name: str) -> list[pytest.Mark]:
    """Return the marks of a name that a function and its module have."""
    own = getattr(module, "pytestmark", [])
    every = [*(own if isinstance(own, list) else [own]), *getattr(function, "pytestmark", [])]
    return [mark for mark in (getattr(one, "mark", one) for one in every) if mark.name == name]


class Fixtures:
    """Fixtures of the benchmark's own module and folder, and those that pytest knows here."""

    def __init__(
        self, small: Small, module: ModuleType, request: pytest.FixtureRequest, shared: Made, stack: ExitStack
    ) -> None:
        self._small, self._request, self._shared, self._stack = small, request, shared, stack
        self._places = [module, *filter(None, [conftest_of(Path(str(module.__file__)).parent)])]
        # The output is checked, so no benchmark may write past it. Ratios of times are not held.
        capture = SimpleNamespace(disabled=nullcontext)
        self._known: dict[str, Any] = {"hold": lambda *_: None, "capsys": capture, **small.arguments}
        self._known["request"] = SimpleNamespace(param=small.parameter, getfixturevalue=self.value)

    def use_automatic_ones(self) -> None:
        for place in self._places:
            for name, one in inspect.getmembers(place, _is_fixture):
                if one._fixture_function_marker.autouse:
                    self.value(name)

    def value(self, name: str) -> Any:
        if name not in self._known:
            own = next((one for place in self._places if _is_fixture(one := getattr(place, name, None))), None)
            self._known[name] = self._request.getfixturevalue(name) if own is None else self._own(name, own)
        return self._known[name]

    def _own(self, name: str, fixture: Any) -> Any:
        if fixture._fixture_function_marker.scope == "function":
            return self._made(fixture, self._stack)
        key = (self._small.module, name)
        if key not in self._shared.values:
            self._shared.values[key] = self._made(fixture, self._shared.stack)
        return self._shared.values[key]

    def _made(self, fixture: Any, stack: ExitStack) -> Any:
        function = fixture._get_wrapped_function()
        needed = [self.value(one) for one in inspect.signature(function).parameters]
        if inspect.isgeneratorfunction(function):
            return stack.enter_context(contextmanager(function)(*needed))
        return function(*needed)


def _is_fixture(one: object) -> bool:
    return hasattr(one, "_get_wrapped_function")


LISTED = """
import pytest, sys

class Cases:
    def pytest_collection_finish(self, session):
        for item in session.items:
            sys.stderr.write(f"{item.get_closest_marker('benchmark') is not None} {item.path} {item.originalname}\\n")

options = ["--collect-only", "-qq", "-n", "0", "-m", "", "-p", "no:cacheprovider"]
sys.exit(pytest.main([*options, *sys.argv[1:]], [Cases()]))
"""


@pytest.mark.slow
def test_every_benchmark_has_a_small_size() -> None:
    """A function with a case that is no benchmark is tested without its benchmark, and needs no other small size."""
    marked = sorted(str(file) for file in TESTS.rglob("test_*.py") if "mark.benchmark" in file.read_text())
    command = [sys.executable, "-c", LISTED, *marked]
    done = subprocess.run(command, cwd=TESTS.parent, capture_output=True, text=True, check=True)
    found: dict[bool, set[tuple[str, str]]] = {True: set(), False: set()}
    for line in done.stderr.splitlines():
        if line.startswith(("True ", "False ")):
            benchmark, file, function = line.split()
            module = str(Path(file).relative_to(TESTS).with_suffix(""))
            found[benchmark == "True"].add((module, function))
    small = [(one.module, one.function) for one in SIZES]
    listed = {*small, *IN_SMALL, *WITHOUT}
    assert listed <= found[True], "no benchmark has these names"
    assert len(listed) == len({*small}) + len(IN_SMALL) + len(WITHOUT)
    assert {(module, test) for (module, _), test in IN_SMALL.items()} <= found[False]
    assert all(len(reason.split()) > 5 for reason in WITHOUT.values())
    missing = found[True] - found[False] - listed
    assert not missing, f"write small sizes in small_sizes.py for {sorted(missing)}"
