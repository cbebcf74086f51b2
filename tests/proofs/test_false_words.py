"""No altered certificate makes the check repeat a false word, although its digest and its statement are renewed."""

import json
from collections.abc import Callable
from typing import Any

import pytest

pytest.importorskip("flint")

from dpcontrol.proofs.balls import working
from dpcontrol.proofs.check import check, digest
from dpcontrol.proofs.statements import statement

pytestmark = [pytest.mark.slow, pytest.mark.usefixtures("remembered")]

BITS = 140
"""Precision of the check, bits, in which a forger composes the statement."""

Content = dict[str, Any]
Alteration = tuple[Callable[[Content], object], str]


def said(old: str, new: str) -> Alteration:
    def change(content: Content) -> None:
        assert old in content["statement"]
        content["statement"] = content["statement"].replace(old, new, 1)

    return change, new


def added(words: str) -> Alteration:
    return (lambda content: content.update(statement=content["statement"] + "\n" + words)), words


def named(key: str, words: str) -> Alteration:
    """Return an alteration that adds a key with false words, as certificates of an earlier format had."""
    return (lambda content: content.update({key: words})), words


def twice(content: Content) -> None:
    for key in ("nodes", "normals", "durations"):
        content[key] = content[key] * 2
    content["turns"] = [2 * k for k in content["turns"]]
    content["period"] = [str(2 * float(content["period"][0]) - 1e-9), str(2 * float(content["period"][1]) + 1e-9)]


def symbol(words: str, **values: Any) -> Alteration:
    return (lambda content: content["symbols"][0].update(values)), words


def more_wraps(content: Content) -> None:
    """Count three wraps more, with the rest shortened by three periods."""
    one = content["symbols"][0]
    one.update(wraps=one["wraps"] + 3, rest=str(float(one["rest"]) - 3 * float(one["period"])))


def flipped(content: Content) -> None:
    """Let the section's crossings count on the other side only."""
    one = content["symbols"][0]
    one["section"].update(side=["0", "-1", "0", "0"], middle="0")
    one["hits"] = [0, 1]


def only_rival(content: Content) -> None:
    """Let the backward turn be the symbol's connection, without any other one."""
    one = content["symbols"][0]
    one["states"] = [["0", "0", "-9.9100", "-21.6894"]]


BACKWARD = "down-up>down-up[0,-1]h1.1@0.0000,9.9100"
WORDS: dict[str, Alteration] = {
    "another model": added("the model is printed"),
    "another saddle": added("the orbit is about up-down"),
    "another stability": said("is hyperbolic", "is elliptic"),
    "no order": said("once, in order", "in any order"),
    "any wraps": said("closes after passing its", "is the only one that crosses its"),
    "another energy": said("-0.07", "-0.06"),
    "a smaller radius": said("1e-12", "1e-30"),
    "a larger ball": said("1e-10", "1e-2"),
    "another duration": said("closes after", "has the least period and closes before"),
    "another start": said("it starts near (", "it starts near (1"),
    "a larger multiplier": said("a multiplier exceeds ", "a multiplier exceeds 9"),
    "another mass": said("mass 0.0938", "mass 0.0939"),
    "another system": said("double pendulum", "triple pendulum"),
    "more sections": said(" sections", "0 sections"),
    "the walk's name": named("symbol", BACKWARD),
    "the model's name": named("model", "printed"),
    "words for the energy": ((lambda content: content.update(energy="-0.07 of up-down")), "up-down"),
    "words for the system": (
        (lambda content: content["system"].update(equations="double pendulum of printed")),
        "printed",
    ),
    "a parameter's name": ((lambda content: content["system"].update(printed=["1"])), "printed"),
    "another gravity": ((lambda content: content["system"].update(gravity=["9.81"])), "gravity 9.81"),
    "an orbit run twice": (twice, "period"),
    "another first node": ((lambda content: content["nodes"][0].__setitem__(2, "7.7542")), "7.7542"),
}
SYMBOLS: dict[str, Alteration] = {
    "the backward turn": (lambda content: content["symbols"][0].update(symbol=BACKWARD), BACKWARD),
    "the backward turn in words": added(f"it follows {BACKWARD}"),
    "wraps with a shorter rest": (more_wraps, "wraps"),
    "a flipped section": (flipped, "0 time"),
    "no rivals": (
        (lambda content: content["symbols"][0].update(states=content["symbols"][0]["states"][:1])),
        "nearer",
    ),
    "the backward turn's state": (only_rival, "21.6894), nearer"),
    "another winding": symbol("(0.0000, -3.1416)", stop_turns=[0, -1, 0, 0]),
    "other hits": symbol("crossing 2", hits=[2, 1]),
    "fewer hits": symbol("0 time", hits=[1, 0]),
    "another section": symbol("1 x1", section={"normal": ["1", "0", "0", "0"], "offset": "0", "period": "2 pi",
                              "side": ["0"] * 4, "middle": "-1", "reach": None}),
    "another stop": symbol("(3.1416, 0.0000)", stop=["3.141592653589793", "0", "0", "0"]),
    "another point": symbol("nearer", states=[["0", "6.2832", "9.9", "21.7"], ["0", "6.2832", "-9.9100", "21.6894"]]),
    "another node": symbol("node 12", node=11),
    "a turn in part": symbol("(0.0000, 6.2832)", turns=[0.4, 0.4, 0, 0], stop_turns=[0, 0.9, 0, 0]),
    "words for the offset": (
        (lambda content: content["symbols"][0]["section"].update(offset="0 of inner-down")),
        "inner-down",
    ),
}  # fmt: skip


def alterations() -> list[tuple[str, str]]:
    """Return the certificates with the names of their alterations."""
    both = [(which, name) for which in ("orbit", "walk") for name in WORDS]
    return [*both, *(("walk", name) for name in SYMBOLS)]


@pytest.mark.parametrize("which", ["orbit", "walk"])
def test_the_check_repeats_the_statement_of_an_unaltered_certificate(
    certificates: dict[str, Content], which: str
) -> None:
    content = certificates[which]
    answer = check(content)
    assert answer.proved, answer.status
    assert answer.statement == content["statement"]


@pytest.mark.parametrize(("which", "name"), alterations())
def test_an_altered_certificate_is_rejected_or_the_answer_lacks_the_false_words(
    certificates: dict[str, Content], which: str, name: str
) -> None:
    change, words = (WORDS | SYMBOLS)[name]
    original = certificates[which]
    content = json.loads(json.dumps(original))
    change(content)
    assert content != original
    answers = [check({**content, "digest": digest(content)})]
    if content["statement"] == original["statement"]:
        try:
            with working(BITS):
                content["statement"] = statement(content)
        except (LookupError, TypeError, ValueError):
            pass
        answers.append(check({**content, "digest": digest(content)}))
    for answer in answers:
        assert not answer.proved or words not in str(answer.statement), answer.statement
