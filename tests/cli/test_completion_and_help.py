"""Shells complete names and values, and help gives defaults."""

from pathlib import Path

import click
import pytest
from click.shell_completion import BashComplete, FishComplete, ShellComplete, ZshComplete
from command_line import dpcontrol

from dpcontrol.cli.main import VERBS, cli
from dpcontrol.loop.controllers import CONTROLLERS

ROOT = Path(__file__).parents[2]
VARIABLE = "_DPCONTROL_COMPLETE"
PREFIX = {BashComplete: "plain,{}", ZshComplete: "plain\n{}\n_", FishComplete: "plain,{}"}


def offered(line: str) -> list[str]:
    """Return the completions of the last word of a line; "" if the shell completes files."""
    *words, last = line.split(" ")
    found = ShellComplete(cli, {}, "dpcontrol", VARIABLE).get_completions(words[1:], last)
    return [item.value if item.type == "plain" else "" for item in found]


@pytest.mark.parametrize(
    ("line", "wanted"),
    [
        ("dpcontrol plan ", {file.stem for file in (ROOT / "itineraries").glob("*.toml")}),
        ("dpcontrol run outer", {"outer-turn"}),
        ("dpcontrol run outer-turn --set drive.la", {"drive.lag="}),
        ("dpcontrol run outer-turn --controller ", set(CONTROLLERS)),
        ("dpcontrol orbit lab --saddle up", {"up-down"}),
        ("dpcontrol connect three-body --from ", {"L1", "L2", "L3"}),
        ("dpcontrol run outer-turn --rig ./my", {""}),
        ("dpcontrol import x.csv --repair nan,g", {"nan,gaps"}),
        ("dpcontrol campaign outer-turn --over mism", {"mismatch="}),
        ("dpcontrol campaign outer-turn --over controller=lqr,a", {"controller=lqr,adaptive"}),
        ("dpcontrol campaign outer-turn --over nosuch=", set()),
        ("dpcontrol he", {"help"}),
        ("dpcontrol plan ./my", {""}),
    ],
)
def test_values_are_completed(line: str, wanted: set[str]) -> None:
    assert set(offered(line)) == wanted


@pytest.mark.parametrize("shell", list(PREFIX))
def test_bash_zsh_and_fish_get_completions_in_their_own_format(
    shell: type[ShellComplete], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("COMP_WORDS", "dpcontrol run two-en")
    monkeypatch.setenv("COMP_CWORD", "two-en" if shell is FishComplete else "2")
    assert shell(cli, {}, "dpcontrol", VARIABLE).complete() == PREFIX[shell].format("two-energies")


def options() -> list[tuple[str, click.Option]]:
    """Return every option with its verb."""
    group = click.Context(cli)
    found = []
    for verb in VERBS:
        command = cli.get_command(group, verb)
        assert command is not None
        found += [(verb, one) for one in command.params if isinstance(one, click.Option)]
    return found


def test_help_gives_the_default_of_every_option_that_takes_a_value() -> None:
    silent = []
    for verb, one in options():
        record = one.get_help_record(click.Context(click.Command(verb)))
        if record is not None and not one.is_flag and not one.required and "[default: " not in record[1]:
            silent.append(f"{verb} {one.opts[0]}")
    assert not silent


def rendered(verb: str) -> str:
    """Return the help of a verb in a terminal of 80 columns."""
    group = click.Context(cli)
    command = cli.get_command(group, verb)
    assert command is not None
    return command.get_help(click.Context(command, info_name=verb, parent=group, terminal_width=80))


@pytest.mark.parametrize("verb", VERBS)
def test_help_fits_80_columns_and_shows_the_whole_text_of_each_option(verb: str) -> None:
    text = rendered(verb)
    assert [line for line in text.splitlines() if len(line) > 80] == []
    shown = "".join(text.split())
    for name, one in options():
        record = one.get_help_record(click.Context(click.Command(verb)))
        if name == verb and record is not None:
            assert "".join(record[1].split()) in shown, record
            assert record[1].endswith((".", "]")), record


def test_an_option_that_help_calls_required_is_required() -> None:
    required = {verb: one for verb, one in reversed(options()) if one.required}
    assert "export" in required
    for verb, one in required.items():
        ended = dpcontrol(verb, "lab")
        assert ended.code == 2, ended.stdout
        assert f"Missing option '{one.opts[0]}'" in ended.message


@pytest.mark.parametrize("verb", ["orbit", "cache"])
def test_help_verb_equals_verb_help(verb: str) -> None:
    assert dpcontrol("help", verb).stdout == dpcontrol(verb, "--help").stdout
    assert f"Usage: dpcontrol {verb}" in dpcontrol("help", verb).stdout
