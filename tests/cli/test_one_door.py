"""A function of `dpcontrol.api` is a verb by one line: options from its signature, help from its docstring."""

import json
from typing import Any

import click
import pytest
from click.testing import CliRunner

from dpcontrol import api
from dpcontrol.cli.commands import command
from dpcontrol.cli.verbs import VERBS, Verb
from dpcontrol.foundation.checked import Count, checked


@checked
def swing_energy(
    model: str, *, angles: tuple[float, float] = (0.0, 0.0), copies: Count = 1, still: bool = False
) -> Any:
    """Return the energy of arms at rest.

    Args:
        model: model, or its name or path.
        angles: absolute angles, rad (default: hanging).
        copies: number of such pendulums (default: 1).
        still: no swing at all.
    """
    return {"model": model, "angles": angles, "copies": copies, "still": still}


@pytest.fixture
def verb(monkeypatch: pytest.MonkeyPatch) -> click.Command:
    monkeypatch.setattr(api, "swing_energy", swing_energy, raising=False)
    return command("swing", Verb("Energy of arms at rest.", "swing_energy", "dpcontrol swing lab"))


def test_a_function_is_a_verb_by_one_line(verb: click.Command) -> None:
    done = CliRunner().invoke(verb, ["lab", "--angles", "1", "2.5", "--still", "--json"], standalone_mode=False)
    assert json.loads(done.stdout) == {"model": "lab", "angles": [1.0, 2.5], "copies": 1, "still": True}


def test_the_function_refuses_what_it_cannot_take(verb: click.Command) -> None:
    done = CliRunner().invoke(verb, ["lab", "--copies", "0"], standalone_mode=False)
    assert str(done.exception).startswith("copies = 0: must be")


@pytest.mark.parametrize("name", VERBS)
def test_each_verb_calls_a_public_function_whose_parameters_are_described(name: str) -> None:
    made = command(name, VERBS[name])
    assert [one.name for one in made.params if isinstance(one, click.Option) and not one.help] == []
