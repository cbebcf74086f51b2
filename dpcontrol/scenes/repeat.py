"""Repeat a run from its log alone: scene, model and reference as attached, settings as noted, message for message.

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
from dpcontrol.foundation.errors import InputError
from dpcontrol.foundation.files import checked_other_file
from dpcontrol.foundation.progress import Progress, no_progress
from dpcontrol.lab.loop import LoopSettings
from dpcontrol.logs import Comparison, RunLog, compare_messages, read_log
from dpcontrol.references.archive import load_reference
from dpcontrol.review.score import REFERENCE_ATTACHMENT, Score
from dpcontrol.scenes.itinerary import Itinerary, load_itinerary
from dpcontrol.scenes.model import load_model
from dpcontrol.scenes.plan import Plan
from dpcontrol.scenes.run import run_plan
from dpcontrol.scenes.run_settings import CONTROLLERS

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
