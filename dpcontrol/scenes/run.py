"""Run an itinerary: its plan, the closed loop, the log.

Repeat a run from its log alone: scene, model and reference as attached, settings as noted, message for message.

A run is determined by these and by the program: all that is random comes from the seed. So on the same version the
new log holds the same bytes in every message; only what the metadata says of the run's pace may differ.
"""

import json
import types
from collections.abc import Mapping
from dataclasses import asdict, dataclass, fields, is_dataclass, replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, get_args, get_origin, get_type_hints

import dpcontrol
from dpcontrol.control.estimation import ESTIMATORS
from dpcontrol.foundation.checkout import commit
from dpcontrol.foundation.errors import GoalMissed, InputError
from dpcontrol.foundation.files import checked_other_file, content_hash
from dpcontrol.foundation.progress import Progress, no_progress
from dpcontrol.logs import Comparison, LogWriter, RunLog, compare_messages, read_log
from dpcontrol.loop.loop import LoopSettings, run_loop
from dpcontrol.loop.result import LogSink
from dpcontrol.references.reference import load_reference
from dpcontrol.review.of_log import MODEL_METADATA
from dpcontrol.review.score import REFERENCE_ATTACHMENT, Score, score
from dpcontrol.scenes.itinerary import CONTROLLERS, Itinerary, load_itinerary
from dpcontrol.scenes.model import load_model
from dpcontrol.scenes.plan import Plan, plan_key


def default_log(itinerary: Itinerary) -> Path:
    """Return logs/NAME-SEED.mcap in the working folder."""
    return Path("logs") / f"{itinerary.name}-{itinerary.loop.seed}.mcap"


def run_plan(plan: Plan, out: Path, *, progress: Progress = no_progress) -> Score:
    """Run the closed loop of a planned itinerary, write its log to `out`, and score it.

    Raises:
        InputError: the log cannot be written; the plant is to be drawn from an uncertainty that the model's file does
            not give.
        GoalMissed: the plan did not converge, or no controller can be made for it, or no plant drawn.
    """
    itinerary, reference = plan.itinerary, plan.reference
    if not reference.converged:
        raise GoalMissed(f"{itinerary.name} has no reference to follow: {reference.status}")
    uncertainty = itinerary.uncertainty
    with log_writer(plan, out) as writer:
        sink = LogSink(writer)
        result = run_loop(
            reference, itinerary.model.arms, settings=itinerary.loop, uncertainty=uncertainty, sink=sink,
            progress=progress,
        )  # fmt: skip
        writer.result(real_time_factor=repr(result.real_time_factor), ending=result.ending.value)
    return score(read_log(out))


def log_writer(plan: Plan, out: Path) -> LogWriter:
    """Return the writer of the log of a run, with all that is known before it.

    Raises:
        InputError: the log cannot be written.
    """
    itinerary = plan.itinerary
    limits = itinerary.loop.limits(plan.reference)
    return LogWriter(
        out,
        arm_lengths=itinerary.model.arms.length,
        rate_hz=itinerary.loop.rate,
        limits=(limits.position, limits.velocity, limits.acceleration),
        metadata=_metadata(itinerary),
        attachments={
            "scene.toml": itinerary.text.encode(),
            "model.toml": itinerary.model.text.encode(),
            REFERENCE_ATTACHMENT: plan.file.read_bytes(),
        },
    )


def _metadata(itinerary: Itinerary) -> Mapping[str, str]:
    """Return what tells this run from others; settings as JSON, so that overrides on the command line are kept."""
    return {
        "version": dpcontrol.__version__,
        "commit": commit(),
        "itinerary": itinerary.name,
        "model": itinerary.model.name,
        "seed": str(itinerary.loop.seed),
        "plan": plan_key(itinerary),
        "scene_hash": content_hash(itinerary.text),
        "model_hash": content_hash(itinerary.model.text),
        "run_settings": json.dumps(asdict(itinerary.loop), sort_keys=True),
        MODEL_METADATA: json.dumps(asdict(itinerary.model.arms), sort_keys=True),
    }


_SCENE, _MODEL = "scene.toml", "model.toml"
_KINDS: Mapping[str, Mapping[str, type]] = {"controller": CONTROLLERS, "estimator": ESTIMATORS}


@dataclass(frozen=True)
class Repeat:
    """A run repeated: its score, the comparison with the log it was repeated from, and a word on another version."""

    score: Score
    comparison: Comparison
    versions: str | None


def repeated_log(source: Path) -> Path:
    """Return logs/NAME-again.mcap in the working folder."""
    return Path("logs") / f"{source.name.removesuffix('.mcap')}-again.mcap"


def repeat_run(source: Path, out: Path, *, progress: Progress = no_progress) -> Repeat:
    """Repeat the run in the log `source`, write its log to `out`, and compare the two message for message.

    Raises:
        InputError: the log cannot be read, lacks what a repetition needs, or `out` is the same file.
        GoalMissed: no controller can be made for its reference.
    """
    log = read_log(source)
    checked_other_file(out, source, what="the log to repeat")
    with TemporaryDirectory() as folder:
        verdict = run_plan(_plan(log, Path(folder)), out, progress=progress)
    then, now = log.metadata.get("version", "?"), dpcontrol.__version__
    versions = None if then == now else f"the log was written by version {then}, this is {now}"
    return Repeat(verdict, compare_messages(source, out), versions)


def _plan(log: RunLog, folder: Path) -> Plan:
    """Return the plan of a logged run, its files in `folder`."""
    needed = (_SCENE, _MODEL, REFERENCE_ATTACHMENT)
    lacking = [name for name in needed if name not in log.attachments]
    lacking += [key for key in ("itinerary", "model", "run_settings") if key not in log.metadata]
    if lacking:
        raise InputError(f"{log.path} cannot be repeated: it lacks {', '.join(lacking)}; give a log of `dpcontrol run`")
    if log.truth is None:
        where = f"the rig at {log.metadata['rig']}" if "rig" in log.metadata else "a rig"
        raise InputError(
            f"{log.path} cannot be repeated: it was made on {where}, and only what is simulated does the same twice; "
            f"`dpcontrol replay` shows what a model makes of it"
        )
    # The names of files are the itinerary's and the model's; of a name that is a path only the end counts.
    scene, model = (folder / kind / f"{Path(log.metadata[kind]).name}.toml" for kind in ("itinerary", "model"))
    for path, name in ((scene, _SCENE), (model, _MODEL), (folder / REFERENCE_ATTACHMENT, REFERENCE_ATTACHMENT)):
        path.parent.mkdir(exist_ok=True)
        path.write_bytes(log.attachments[name])
    itinerary = load_itinerary(str(scene), model=load_model(str(model)))
    file = folder / REFERENCE_ATTACHMENT
    return Plan(_with_settings(itinerary, log), load_reference(file), file, cached=True)


def _with_settings(itinerary: Itinerary, log: RunLog) -> Itinerary:
    """Return the itinerary with the run's settings as the log notes them: overrides and all."""
    text = log.metadata["run_settings"]
    try:
        loop = _settings(LoopSettings, json.loads(text))
        same = json.loads(json.dumps(asdict(loop))) == json.loads(text)
    except (TypeError, ValueError, LookupError) as error:
        raise InputError(f"{log.path} cannot be repeated: its run settings do not read: {error}") from error
    if not same:
        raise InputError(
            f"{log.path} cannot be repeated: its run settings are of another version; use the one that wrote it "
            f"({log.metadata.get('version', '?')}, commit {log.metadata.get('commit') or 'unknown'})"
        )
    return replace(itinerary, loop=loop)


def _settings(kind: type, values: Mapping[str, Any]) -> Any:
    """Return settings of dataclass `kind` from what `asdict` and JSON made of them."""
    hints = get_type_hints(kind)
    given = {}
    for field in fields(kind):
        if field.init and field.name in values:
            given[field.name] = _value(field.name, hints[field.name], values[field.name])
    return kind(**given)


def _value(name: str, hint: Any, value: Any) -> Any:
    if isinstance(value, Mapping):
        found = _KINDS[name][value["kind"]] if name in _KINDS else _dataclass_in(hint)
        return _settings(found, value)
    if isinstance(value, list):
        inner = get_args(hint)[0] if get_args(hint) else Any
        return tuple(_value(name, inner, item) for item in value)
    return value


def _dataclass_in(hint: Any) -> type:
    options = get_args(hint) if get_origin(hint) is types.UnionType else (hint,)
    return next(option for option in options if is_dataclass(option) and isinstance(option, type))
