"""Sentences of runs: their events, falls, ends and verdicts.

`SENTENCES` has one for each cause, with its numbers by name. `PHRASES` has parts of them that depend on numbers.
"""

import json
import math
from collections.abc import Iterator, Mapping, Sequence
from itertools import zip_longest
from typing import Any

from dpcontrol.foundation.causes import Cause, Fault
from dpcontrol.words.table import Line

_LOST = "estimate lost at t = {time:.3f} s:"
_FAILED = "drive failed at t = {time:.3f} s:"
_BRAKE = "at {position:.3f} m{speed} it must brake now to stay on the track"
_STOP = "cart at its stop at t = {time:.3f} s:"
_TRACKING = "tracking lost at t = {time:.3f} s:"

SENTENCES: dict[str, str] = {
    Cause.RESTART: "{defect}: the estimator restarts from the encoders",
    Cause.RESYNCHRONISE: "an angle is {error:.2g} rad from the reference",
    Cause.HOLD: _TRACKING + " an angle has stayed {error:.2g} rad from the reference",
    Cause.ESTIMATE_LOST: _LOST + " {defect}; check the encoders and the model's parameters",
    Cause.SILENT: _LOST + " no measurement for {silent:.3f} s; check the encoders' cables",
    # No remedy is given: a longer track saves a third of such runs, and half of those near their reference.
    Cause.CART: f"{_STOP} {_BRAKE}, with an angle {{distance:.2g}} rad from the reference",
    Cause.TRACKING_LOST: _TRACKING + " an angle has stayed {error:.2g} rad from the reference",
    Cause.STUCK: _LOST + " {sensor_name} is stuck: it has given the same reading for {repeated:.3g} s; check its cable "
    "and its head",
    Cause.SWITCH: _STOP + " a limit switch was touched, with an angle {distance:.2g} rad from the reference",
    Cause.FALLEN: f"{_TRACKING} an angle is {{distance:.2g}} rad from the reference, and the cart runs away after it: "
    f"{_BRAKE}",
    Cause.DRIVE_OFF: _FAILED + " the cart does not follow the commands: is the drive on? Check its power, its enabling "
    "and its cable, and the cart's scale",
    Cause.DRIVE_REVERSED: _FAILED + " the cart moves against the commands: check the signs of the drive and of the "
    "cart's scale, and that the drive is on",
    Cause.TOO_FAST: _TRACKING + " the cart moves at {fast:.3g} m/s, the reference at {planned:.3g} m/s",
    Cause.NOT_HELD: "the last stop was not held: over the last period the arms were up to {away:.2g} rad from its "
    "orbit",
    Cause.HARD_STOP: "cart hit its hard stop at t = {time:.3f} s: x = {position:.3f} m at {velocity:.3g} m/s",
    Cause.PLANT_FAILED: "plant failed at t = {time:.3f} s: its state is no longer finite",
    Cause.FINISHED: "came to the reference's end",
    Cause.TIME_OVER: "the requested time is over",
    Cause.BEGUN: "{law}, {estimator}, {ticks} ticks at {rate:g} Hz",
    Cause.JOINED: "on the itinerary from t = {at:.4f} s of the reference: {progress}",
    Cause.LAP_DONE: "repetition {lap} is done; a flight leads to the next one",
    Cause.FLOWN: "to {goal} in {duration:.2f} s: {progress}",
    Cause.MISSED: "the arms are not near enough to {goal}",
    Cause.ANYWHERE: "a flight leads to the first stop",
    Cause.CLOCKLESS: "the controller has no clock to move",
    Cause.LATE: "a tick's command comes {late_ms:.3g} ms too late; {count} such ticks so far",
    Cause.CUT: "command {wish:.3g} m/s², cut to {command:.3g} m/s²",
    Cause.UNTRUSTED: "model error: {parameter} is estimated to be off by {share:+.0%}, beyond the first-order range "
    "(trust {trust:g}); identify the arms, or tracking may be lost",
    Fault.NONE: "{done} to the end",
    Fault.STAMPS: "its stamps jump by {step:+.3g} s at t = {time:.2f} s, where its period is {period:g} s: the arms' "
    "motion between them is unknown",
    Fault.PART: "the log covers only {first:.3f} to {last:.3f} s of the run's {lasted:.3f} s",
    Fault.OTHER_TIMES: "the log's times, {first:.3f} to {last:.3f} s, are not those of the run, which lasted "
    "{lasted:.3f} s",
    Fault.AT_ONCE: "ended within the first half period about {saddle}",
    Fault.NOT_BEGUN: "did not start on the orbit about {saddle}",
    Fault.FIRST_LEFT: "left the orbit about {saddle} within its first half period",
    Fault.SYMBOL: "{symbol_name} was not done",
    Fault.LAST_LEFT: "left the last orbit {last_symbol}",
    Fault.WRAPS: "wraps at stop {stop} are {wraps} instead of {wanted}, before symbol {before}",
    Fault.DRIVE_LIMIT: "the drive's acceleration of {value:.3f} passed the limit of {limit:g}",
    Fault.LIMIT: "cart {quantity} {value:.3f} passed its limit of {limit:g} at t = {time:.2f} s",
    Fault.LAST_ENDED: "the last orbit was not held to the end {last_symbol}",
    Fault.LAST_FAR: "over the last period the arms were up to {gap:.2f} rad from the orbit about {saddle} "
    "{last_symbol} (allowed: {allowed:g})",
}

ADDITIONS = {
    "far": ": from t = {far:.2f} s an angle was more than {follows:g} rad from the reference",
    "back": "; caught, {back:.2f} s back: cost-to-go {least:.3g} instead of {here:.3g}",
    "held": "; {held}",
    "falls": "; given up after {falls_counted}",
    "again": "; {next_motion}",
    "short": "; the run ended {short:.2f} s early",
}
"""Additions to a sentence if the number of that name belongs to its cause."""

_ASTRAY = 1.0
"""Distance from the encoders at which an estimate has slipped at any NIS, rad."""
_LEAST_LOST = 5.0
"""Mean NIS above which an estimate can count as lost; see `SupervisorSettings`."""


def told(cause: str, figures: Mapping[str, Any]) -> str:
    """Return the sentence of a cause with its numbers, and with the additions that these numbers call for.

    Args:
        cause: value of a `Cause` or a `Fault`.
        figures: numbers and names for the sentence of this cause.
    """
    additions = (text for name, text in ADDITIONS.items() if name in figures)
    return "".join([SENTENCES.get(cause, ""), *additions]).format_map({**figures, **_phrases(figures)})


def _phrases(figures: Mapping[str, Any]) -> dict[str, str]:
    """Return the parts of sentences that depend on several numbers or have two forms, by their names in `SENTENCES`.

    All phrases are made; those that the sentence of the cause does not contain are not used.

    Args:
        figures: numbers and names of a cause; for a missing one its phrase is made of zero or of an empty text.
    """
    symbols, symbol = figures.get("symbols", 0), figures.get("symbol", 0)
    is_repeated, velocity, sensor = (figures.get(name, 0) for name in ("again", "velocity", "sensor"))
    symbol_text = f"{figures.get('motion', '')} {symbol} of {symbols} ({figures.get('name', '')!r})"
    attempt = f"{symbol_text if symbol else 'the last stop'}, attempt {figures.get('attempt', 0)}"
    repeated = f"{symbol_text} is repeated" if symbol else "the run returns to the last stop"
    return {
        "speed": f" with {velocity:.2f} m/s" if math.isfinite(velocity) else "",
        "defect": _defect(figures.get("mean_nis", 0.0), figures.get("apart", 0.0)),
        "sensor_name": f"the encoder of joint {sensor}" if sensor else "the cart's scale",
        "symbol_name": symbol_text,
        "progress": f"repetition {figures['lap']}" if "lap" in figures else attempt,
        "goal": f"stop {figures['stop']} ({figures['stop_name']})" if figures.get("stop") else "rest",
        "last_symbol": f"after {symbol_text}" if symbols else "to be kept",
        "next_motion": repeated if is_repeated else "the itinerary restarts",
        "falls_counted": f"{(falls := figures.get('falls', 0))} fall{'s' * (falls != 1)}",
        "done": _done(figures) if "lowest" in figures else "",
    }


def _defect(nis: float, apart: float) -> str:
    """Return the defect of a lost estimate in words.

    Args:
        nis: mean NIS of the last updates, for each measured position.
        apart: distance between the estimated and the measured angles, rad.
    """
    if not math.isfinite(nis + apart):
        return "it is no longer finite"
    if apart > _ASTRAY:
        return f"it is {apart:.3g} rad from the encoders"
    if nis < _LEAST_LOST:
        return "its rates have run away"
    return f"mean NIS {nis:.3g} for each position, about 1 is expected"


def counted(done: int, total: int, transfers: tuple[int, int]) -> str:
    """Return the numbers of completed symbols and of transfers as text, such as "2 of 3 symbols and 1 of 1 transfers".

    Args:
        done: number of completed motions between stops.
        total: number of all motions.
        transfers: numbers of completed and of all transfers among them.
    """
    rows = [(done - transfers[0], total - transfers[1], "symbols"), (*transfers, "transfers")]
    return " and ".join(f"{reached} of {several} {noun}" for reached, several, noun in rows if several)


def _done(figures: Mapping[str, Any]) -> str:
    """Return the sentence on a completed run: symbols and transfers, wraps, and its end.

    Args:
        figures: numbers and names of `Fault.NONE`: `motions` is the number of symbols and `transfers`, `saddle` is that
            of the last stop, and `wraps` are the counts of the run. `stay` is "hold" or "orbit" for a plan that only
            stays at an equilibrium or an orbit, else "". `lowest` is True if the run ends at rest, with the arms
            hanging.
    """
    total, saddle = figures["motions"], figures["saddle"]
    if not total and figures["stay"]:
        return f"stayed {'at' if figures['stay'] == 'hold' else 'on the orbit about'} {saddle}"
    transfers = figures["transfers"]
    rows = [(count, noun) for count, noun in ((total - transfers, "symbol"), (transfers, "transfer")) if count]
    motions_text = f"all {total} {rows[0][1]}s done in order"
    if total == 1 or len(rows) > 1:
        nouns = " and ".join(f"the {noun}" if count == 1 else f"all {count} {noun}s" for count, noun in rows)
        motions_text = f"{nouns} done" + " in order" * (total > 1)
    wraps_text = f", wraps {figures['wraps']} as asked" if figures["wraps"] else ""
    stay_text = f"held at {saddle}" if figures.get("still") else "on the last orbit"
    return f"{motions_text}{wraps_text}, and {'at rest' if figures['lowest'] else stay_text}"


_TOLD = {
    "rate": ("{} Hz", 1.0),
    "sensors.counts": ("{} counts per turn", 1.0),
    "drive.delay": ("delay {} × period", 1.0),
    "drive_lag": ("assumed lag {} ms", 1e3),
}
"""Conditions that the controller knows, by the path of their setting: text, and factor to its unit."""
_SIMULATED = {
    "mismatch": ("mismatch ±{} %", 100.0),
    "friction": ("friction × {}", 1.0),
    "drive.lag": ("lag {} ms", 1e3),
    "sensors.noise": ("noise {} mrad", 1e3),
    "initial_error": ("initial error ±{} rad", 1.0),
}
"""Conditions of a simulated bench."""


def conditions(settings: Sequence[Mapping[str, Any]], *, simulated: bool) -> str:
    """Return the conditions that all of some runs share (rate, delay, mismatch …), for the head of a page.

    A condition that differs between the runs is left out.

    Args:
        settings: settings of each run as JSON values.
        simulated: True for runs on a simulated bench.
    """
    shared_conditions = []
    for path, (text, factor) in {**(_SIMULATED if simulated else {}), **_TOLD}.items():
        first_value, *other_values = (_at(setting, path) for setting in settings)
        if all(value == first_value for value in other_values):
            values = first_value if isinstance(first_value, list) else [first_value]
            shared_conditions.append(text.format(" and ".join(f"{factor * value:,.6g}" for value in values)))
    return ", ".join(shared_conditions)


def conditions_of(metadata: Mapping[str, str]) -> tuple[str, ...]:
    """Return the model, the conditions and the program of a run, for the head of its page.

    Args:
        metadata: metadata of its log; none of a recording or a reference.
    """
    bench = ""
    if text := metadata.get("run_settings"):
        bench = conditions([json.loads(text)], simulated="plant_parameters" in metadata)
    model = f"model {metadata['model']}" if "model" in metadata else ""
    return model, bench, metadata.get("program", "")


def _at(settings: Mapping[str, Any], path: str) -> Any:
    """Return the JSON value of a setting at its path, "key" or "table.key", in settings by table and key."""
    table, _, key = path.rpartition(".")
    return settings[table][key] if table else settings[key]


def verdict(fault: str, figures: Mapping[str, Any], end: str) -> str:
    """Return the sentence of a verdict: the fault, or the completed symbols, and the end of the run.

    Args:
        fault: value of a `Fault`.
        figures: numbers and names for the sentence of this fault.
        end: sentence of the event that ended the run early or let it fall back, or "".
    """
    separator = ": " if "short" in figures else "; "
    return told(fault, figures) + (f"{separator}{end}" if end else "")


def reason(text: str, *, judged_by: str, whole: bool, recovered: str) -> str:
    """Return the reason of a score, qualified if the log is not whole or the truth is not known.

    Args:
        text: reason of the verdict.
        judged_by: "truth" or "estimate".
        whole: False if the log covers only a part of the run.
        recovered: losses of a recovered log, or "".
    """
    if not whole:
        text = f"{text}, so completion cannot be judged"
    elif judged_by == "estimate":
        text = f"the true state is not known, so completion cannot be judged; by the estimate: {text}"
    return f"{text}; {lost(recovered)}" if recovered else text


def lost(losses: str) -> str:
    """Return the note on the messages that a recovered log lacks.

    Args:
        losses: the losses in words.
    """
    return f"the log was recovered and lacks {losses}"


_WHY = "  why      "


def score_lines(verdict: Any, *, why: Any = None) -> Iterator[str]:
    """Yield the lines of a score of one log.

    Args:
        verdict: a `Score`.
        why: a `Why` with options that complete the run; by default, the command that searches for them is named.
    """
    pace = "" if verdict.real_time_factor is None else f", {verdict.real_time_factor:.1f} × real time"
    yield verdict.log
    yield f"  {verdict.sentence}"
    yield (
        f"  tracking {verdict.rms_tracking_error * 1e3:.1f} mrad rms; cart {verdict.max_cart_position * 1e3:.1f} mm at "
        f"most, {verdict.rms_cart_acceleration:.3f} m/s² rms; NIS inside its 95 % band "
        f"{verdict.nis_inside_95:.1%}{pace}"
    )
    if verdict.nis_means is not None:
        yield f"  NIS      {verdict.nis_means.sentence}"
    if why is not None:
        yield f"{_WHY}{why.sentence}"
        yield from (f"{' ' * len(_WHY)}{line}" for line in why.lines())
    elif verdict.completed is False:
        yield f"{_WHY}`dpcontrol score LOG --why` searches for options that complete a simulated run of built-in parts"
    if verdict.thinking is not None:
        median, within_99 = 1e6 * verdict.thinking.median, 1e6 * verdict.thinking.within_99
        yield f"  thinking {median:.3g} µs a tick in the median, 99 % within {within_99:.3g} µs"


def run_lines(run: Any) -> Iterator[str]:
    """Yield the score of a run, and the deadlines of one in real time.

    Args:
        run: a `Run`.
    """
    yield from score_lines(run.score())
    if run.deadlines is not None:
        yield f"  {run.deadlines.sentence}"
    if run.difference is not None:
        yield f"  the program's commands differ from the loop's own by {run.difference:.2g} m/s² at most"


def repeat_lines(repeat: Any) -> Iterator[str]:
    """Yield the score of a repeated run, and the number of identical messages.

    Args:
        repeat: a `Repeat`.
    """
    yield from score_lines(repeat.score)
    yield f"  repeats {repeat.source}: {repeat.comparison.messages:,} messages are identical"


def commissioning_lines(result: Any) -> Iterator[str]:
    """Yield the findings of a commissioning with their remedies.

    Args:
        result: a `Commissioning`.
    """
    yield f"commissioning for {result.itinerary} on {result.bench or 'the example bench, simulated'}"
    for finding in result.findings:
        yield f"  {finding.verdict:6}  {finding.step}: {finding.sentence}"
        if finding.remedy:
            yield f"          → {finding.remedy}"
    if result.written is not None:
        values = ", ".join(f"{key} = {value}" for key, value in result.changes.items())
        yield f"{result.written}: [run] now has {values}"
    elif result.unwritten and not result.changes:
        yield result.unwritten


def bench_lines(bench: Any) -> Iterator[str]:
    """Yield the address of an example bench.

    Args:
        bench: a `UdpBench`.
    """
    yield f"bench at {bench.url}"


def kibibytes(count: float | None) -> str:
    """Return an amount of memory as text in KiB.

    Args:
        count: number of bytes, None if unknown.
    """
    return "unknown (no gcc to measure it)" if count is None else f"{count / 1024:.1f} KiB"


def scores_lines(result: Any) -> Iterator[Line]:
    """Yield the lines of the score of each log, or of each long run.

    Args:
        result: a `Scores`.
    """
    for score, why in zip_longest(result.results, result.whys):
        yield from score.lines() if why is None else score_lines(score, why=why)


def report_lines(result: Any) -> Iterator[Line]:
    """Yield the result that a page shows, and the page's file.

    Args:
        result: a `Report`.
    """
    yield from result.result.lines()
    if result.margins is not None:
        yield f"  margins  {result.margins.status}"
    yield f"page       {result.page}"
