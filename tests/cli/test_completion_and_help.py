"""Shells complete names and values, help gives defaults, and every error message has one form."""

import json
from pathlib import Path

import click
import pytest
from click.shell_completion import BashComplete, FishComplete, ShellComplete, ZshComplete
from command_line import dpcontrol

from dpcontrol.cli.main import VERBS, cli
from dpcontrol.foundation.guide import GUIDE
from dpcontrol.loop.controllers import CONTROLLERS, ESTIMATORS
from dpcontrol.recordings.checks import REPAIRS
from dpcontrol.rig.bench import FAULTS

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
        ("dpcontrol model ", {file.stem for file in (ROOT / "models").glob("*.toml")}),
        ("dpcontrol run outer-turn --set drive.la", {"drive.lag="}),
        ("dpcontrol guide ", {file.stem for file in GUIDE.glob("*.md")} - {"README"}),
        ("dpcontrol run outer-turn --controller ", set(CONTROLLERS)),
        ("dpcontrol campaign outer-turn --estimator ", set(ESTIMATORS)),
        ("dpcontrol run outer-turn --on-fall re", {"resume", "restart"}),
        ("dpcontrol commission outer-turn --fault ", set(FAULTS)),
        ("dpcontrol orbit lab --saddle up", {"up-down"}),
        ("dpcontrol connect three-body --from ", {"L1", "L2", "L3"}),
        ("dpcontrol orbit triple --saddle down-up", {"down-up-down"}),
        ("dpcontrol prove orbit triple --saddle down-down", {"down-down-up"}),
        ("dpcontrol connect lab --from down", {"down-up"}),
        ("dpcontrol connect lab --section a", {"aligned"}),
        ("dpcontrol connect three-body --section ", {"opposite", "between"}),
        ("dpcontrol run outer-turn --rig u", {"udp"}),
        ("dpcontrol run outer-turn --rig ./my", {""}),
        ("dpcontrol import x.csv --mapping multi-arm-raw-s", {"multi-arm-raw-single"}),
        ("dpcontrol import x.csv --repair ", set(REPAIRS)),
        ("dpcontrol import x.csv --repair nan,g", {"nan,gaps"}),
        ("dpcontrol walk lab --through down", {"down-up"}),
        ("dpcontrol campaign outer-turn --over mism", {"mismatch="}),
        ("dpcontrol campaign outer-turn --over controller=o", {"controller=ogy", "controller=ogy-classic"}),
        ("dpcontrol campaign outer-turn --over controller=lqr,a", {"controller=lqr,adaptive"}),
        ("dpcontrol campaign outer-turn --over nosuch=", set()),
        ("dpcontrol figures col", {"colour-wheels", "colour-wheels-up-down"}),
        ("dpcontrol bench propa", {"propagation"}),
        ("dpcontrol he", {"help"}),
        ("dpcontrol plan ./my", {""}),
        ("dpcontrol score ", {""}),
        ("dpcontrol run --from ", {""}),
    ],
)
def test_values_are_completed(line: str, wanted: set[str]) -> None:
    assert set(offered(line)) == wanted


def test_symbols_of_a_walk_are_completed() -> None:
    found = ShellComplete(cli, {}, "dpcontrol", VARIABLE).get_completions(["walk", "lab", "-s"], "down-up")
    assert [item.value for item in found] == ["down-up +", "down-up -", "down-up > up-down"]


@pytest.mark.parametrize("shell", list(PREFIX))
def test_bash_zsh_and_fish_get_completions_in_their_own_format(
    shell: type[ShellComplete], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("COMP_WORDS", "dpcontrol run two-en")
    monkeypatch.setenv("COMP_CWORD", "two-en" if shell is FishComplete else "2")
    assert shell(cli, {}, "dpcontrol", VARIABLE).complete() == PREFIX[shell].format("two-energies")


@pytest.mark.slow
def test_all_figures_are_offered() -> None:
    from dpcontrol.pages.figures import FIGURES

    assert offered("dpcontrol figures ") == list(FIGURES)


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


def test_settings_of_a_run_have_the_itinerary_as_their_default() -> None:
    (one,) = (one for verb, one in options() if (verb, one.name) == ("run", "mismatch"))
    record = one.get_help_record(click.Context(click.Command("run")))
    assert record is not None
    assert record[1].endswith("[default: the itinerary's]")


@pytest.mark.parametrize("verb", ["orbit", "cache"])
def test_help_verb_equals_verb_help(verb: str) -> None:
    assert dpcontrol("help", verb).stdout == dpcontrol(verb, "--help").stdout
    assert f"Usage: dpcontrol {verb}" in dpcontrol("help", verb).stdout


def test_help_alone_shows_the_help_of_the_program() -> None:
    for call in (("help",), ("help", "help"), ("help", "--help")):
        assert dpcontrol(*call).stdout == dpcontrol("--help").stdout


def test_help_refuses_a_second_verb_and_names_verbs_in_capitals() -> None:
    assert "help shows one verb; remove 'plan run'" in dpcontrol("help", "orbit", "plan", "run").message
    assert "did you mean 'orbit'?" in dpcontrol("help", "ORBIT").message


@pytest.mark.parametrize(
    ("line", "said"),
    [
        ("orbit", "Missing argument 'MODEL'; see `dpcontrol orbit --help`"),
        ("orbit lab --nosuch 3", "No such option '--nosuch'; see `dpcontrol orbit --help`"),
        ("run --seed x outer-turn", "'x' is not a valid integer; see `dpcontrol run --help`"),
        ("orbt", "there is no verb 'orbt'; did you mean 'orbit'?; see `dpcontrol --help`"),
        ("model nosuch", "there is no model named 'nosuch'"),
    ],
)
def test_an_error_is_one_line_and_with_json_a_document(line: str, said: str) -> None:
    ended = dpcontrol(*line.split())
    assert (ended.code, ended.stdout) == (2, "")
    assert ended.stderr.startswith("dpcontrol: ")
    assert ended.stderr.count("\n") == 1
    assert said in ended.stderr
    document = json.loads(dpcontrol(*line.split(), "--json").stdout)
    assert document["error"] is True
    assert said in document["status"]
