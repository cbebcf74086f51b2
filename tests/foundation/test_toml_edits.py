"""Edits of TOML text change only the given keys, not comments, order, spacing or line ends."""

import tomllib

import pytest

from dpcontrol.foundation.toml import with_values

SCENE = """\
title = "A scene"   # [run] is below

[run]   # of the bench
rate  = 1000.0   # Hz
delay = 1        # samples # as the drive's manual says
# zeros = [0.0, 0.0]

[[run.blows]]
time = 1.0

[limits]
delay = "not this one"
"""
VALUES = {"delay": 2.5, "zeros": [0.03, -0.02]}


def test_a_key_keeps_its_place_and_comment_and_a_new_one_follows_the_last() -> None:
    lines = SCENE.splitlines()
    changed = with_values(SCENE, "run", VALUES).splitlines()
    assert changed[4] == "delay = 2.5        # samples # as the drive's manual says"
    assert changed[6] == "zeros = [0.03, -0.02]"
    assert changed[:4] + changed[5:6] + changed[7:] == lines[:4] + lines[5:]


@pytest.mark.parametrize(
    "text",
    [
        "",
        "[ run ] # mine\ndelay=1",
        "[run]\nzeros = [\n  1.0, # one\n  2.0,\n]\nrate = 1.0\n",
        "run = {delay = 1}\n",
        '["run"]\n"delay" = 1\n[limits]\nposition = 1.0\n[[run.blows]]\ntime = 1.0\n',
        '[run]\nnote = """\n[run]\ndelay = 7\n"""\ndelay = 3\n',
    ],
)
def test_edited_text_parses_to_the_old_keys_with_the_new_values(text: str) -> None:
    for end in ("\n", "\r\n"):
        before = text.replace("\n", end)
        after = with_values(before, "run", VALUES)
        was = tomllib.loads(before)
        assert tomllib.loads(after) == {**was, "run": {**was.get("run", {}), **VALUES}}
        if end in before:
            assert after.count("\n") == after.count(end)
        assert with_values(after, "run", VALUES) == after
