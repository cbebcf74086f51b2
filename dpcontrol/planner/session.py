"""What one page has chosen and made. A page that is loaded again finds it by the session's name.

A session has two kinds of long work, each in a process of its own: "look", the atlas of the energy that is looked at,
where the newest request replaces the one before, and "work" on the itinerary, one job at a time.
"""

import itertools
import json
import shutil
import tempfile
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

from dpcontrol.foundation.errors import InputError
from dpcontrol.foundation.files import plain, write_whole
from dpcontrol.planner.draft import Draft, enough_wraps, fault_of, first_text, read_draft
from dpcontrol.planner.shown import energies_of, fitting_model, shown_model
from dpcontrol.planner.workers import WorkerJob, Workers
from dpcontrol.scenes.plan import plan_key

_UNDONE = 200
"""Changes that can be undone."""
_ITINERARIES, _LOGS = Path("itineraries"), Path("logs")
_KEYS = {"": {"energy", "walk", "wraps", "start", "finish"}, "run": {"mismatch", "lag", "pushes"}}
"""What the page has controls for, by table."""
_AFTER = {"": ("plan", "run", "seeds", "page"), "plan": ("run", "seeds", "page"), "run": ("page",)}
"""What is out of date when something changes, by what does."""

Done = Callable[[Any], None]


class PageSession:
    """One page's choices. send: called with each message for the page, as JSON."""

    def __init__(self, workers: Workers, model: str, send: Callable[[str], None]) -> None:
        self._workers, self._send = workers, send
        self._folder = Path(tempfile.mkdtemp(prefix="dpcontrol-planner-"))
        self._texts, self._at, self._typed = [self._first(model)], 0, False
        self._draft = read_draft(self._texts[0])
        self._name = next(name for name in _names() if not (_ITINERARIES / f"{name}.toml").exists())
        self._atlas: dict[str, Any] = {}
        self._made: dict[str, Any] = {}
        self._made_of = ""
        self._saved: dict[str, str] = {}
        self._message = {"text": "", "kind": ""}
        self._acknowledged = 0
        self._shown: dict[str, str] = {}
        self._jobs: dict[str, WorkerJob] = {}
        self._again: Callable[[], None] | None = None
        self._look()

    def everything(self) -> list[str]:
        """Return all messages that a page needs which has just been loaded."""
        first = [] if self._draft.model is None else [_message("model", shown_model(self._draft.model))]
        # The number of commands is that of the page before.
        self._acknowledged = 0
        return [*first, *self._shown.values(), _message("state", self.state())]

    def state(self) -> dict[str, Any]:
        """Return what the page shows beside motions and drawings."""
        working = next((job for slot in ("work", "look") if (job := self._jobs.get(slot))), None)
        draft, symbols = self._draft.document(), self._atlas.get("symbols", {})
        known = {*self._atlas.get("names", ()), *symbols}
        return {
            **draft,
            "energy": draft["energy"] if draft["energy"] is not None else self._atlas.get("energy"),
            "names": [symbols.get(text, text) for text in draft["walk"]],
            "unknown": [k for k, text in enumerate(draft["walk"]) if known and text not in known],
            "name": self._name,
            **{kind: self._made.get(kind) for kind in ("plan", "run", "seeds")},
            "saved": self._saved or None,
            "busy": None if working is None else {"what": working.what, "done": working.done},
            "working": "work" in self._jobs,
            "message": self._message,
            "retry": self._again is not None,
            "undo": self._at > 0,
            "redo": self._at < len(self._texts) - 1,
            "ack": self._acknowledged,
        }

    def command(self, asked: Any) -> None:
        """Do what a page asks for, and send it what has changed. Nonsense is answered with a sentence."""
        try:
            given = dict(asked)
            self._acknowledged = int(given.pop("n", 0))
            self._say("")
            getattr(self, f"do_{given.pop('do')}")(**given)
        except InputError as error:
            self._say(str(error), "error")
        except (TypeError, ValueError, OverflowError, KeyError, AttributeError) as error:
            self._say(f"the command is not understood: {error}", "error")
        self._tell()

    def do_model(self, name: str) -> None:
        """Begin with another model."""
        self._change(self._first(str(name)))

    def do_set(self, values: dict[str, Any], table: str = "") -> None:
        """Set keys of the itinerary's text."""
        if not values.keys() <= _KEYS[table]:
            raise InputError(f"{', '.join(values)}: the page sets other keys; write these in the TOML")
        self._change(self._draft.changed(table, values))

    def do_toml(self, text: str) -> None:
        """Take the text as edited; edits that follow one another are undone together."""
        self._change(str(text), typed=True)

    def do_undo(self) -> None:
        """Return to the text before."""
        self._step(-1)

    def do_redo(self) -> None:
        """Return to the text after."""
        self._step(1)

    def do_plan(self) -> None:
        """Plan the itinerary."""
        draft = self._whole()

        def failed(sentence: str) -> None:
            wraps = enough_wraps(sentence)
            self._made["plan"] = {
                "converged": False, "status": sentence, "fault": fault_of(sentence, draft.walk),
                "wraps": wraps if wraps and len(wraps) == len(draft.wraps) else None,
            }  # fmt: skip

        self._work("plan", failed=failed, text=draft.text)

    def do_run(self, seed: int = 0) -> None:
        """Run the plan, which is made first if it is not kept."""
        if not 0 <= int(seed) < 2**31:
            raise InputError(f"seed = {seed}: must be 0 to 2147483647")
        log = str(self._folder / f"run-{int(seed)}.mcap")
        self._work("run", text=self._whole().text, seed=int(seed), log=log)

    def do_seeds(self) -> None:
        """Run twenty seeds."""
        self._work("seeds", text=self._whole().text)

    def do_page(self) -> None:
        """Draw the run's page."""
        self._work("page", log=self._run()["log"])

    def do_rerun(self) -> None:
        """Open the run in the viewer."""
        self._work("rerun", lambda _: self._say("the viewer is open", "good"), log=self._run()["log"])

    def do_film(self) -> None:
        """Write the run's film."""
        film = self._target(_LOGS / f"{self._name}-{self._run()['seed']}.gif", "film")
        film.parent.mkdir(parents=True, exist_ok=True)
        self._work("film", lambda _: self._note(film=str(film)), log=self._run()["log"], film=str(film))

    def do_name(self, name: str) -> None:
        """Name the files to save."""
        if not 0 < len(name) <= 80 or not name.isprintable() or set(name) & set(r"\/:*?<>|\"") or name[0] in ".- ":
            raise InputError(f"name = {name[:80]!r}: use letters, digits and dashes; it names files")
        self._name = name

    def do_save(self) -> None:
        """Write the itinerary, and the log of its run if there is one."""
        text, run = self._whole().text, self._made.get("run")
        toml = self._target(_ITINERARIES / f"{self._name}.toml", "toml")
        log = None if run is None else self._target(_LOGS / f"{self._name}-{run['seed']}.mcap", "log")
        write_whole(toml, text)
        self._note(toml=str(toml))
        if log is not None and run is not None:
            write_whole(log, Path(run["log"]).read_bytes())
            self._note(log=str(log))
        self._say(f"saved {toml}{f' and {log}' if log else ''}; run it with `dpcontrol run {self._name}`", "good")

    def do_cancel(self) -> None:
        """Kill the process of the work under way; what it had kept stays."""
        if slot := next((slot for slot in ("work", "look") if slot in self._jobs), ""):
            job = self._jobs.pop(slot)
            job.kill()
            self._again = job.again
            self._say(f"cancelled: {job.what}")

    def do_retry(self) -> None:
        """Begin the work again whose process has ended."""
        if self._again is not None:
            self._again()

    def close(self) -> None:
        """End what is under way, and remove what was not saved."""
        for job in self._jobs.values():
            job.kill()
        self._jobs.clear()
        shutil.rmtree(self._folder, ignore_errors=True)

    def _step(self, by: int) -> None:
        self._at = min(max(self._at + by, 0), len(self._texts) - 1)
        self._read()

    def _first(self, model: str) -> str:
        return first_text(model, energies_of(fitting_model(model))[2])

    def _whole(self) -> Draft:
        if self._draft.itinerary is None:
            wrong = self._draft.mistake
            raise InputError(wrong.message if wrong else "the walk has no symbol yet: click a connection")
        return self._draft

    def _run(self) -> dict[str, Any]:
        if self._made.get("run") is None:
            raise InputError("there is no run yet: press Run")
        return self._made["run"]

    def _target(self, file: Path, kind: str) -> Path:
        """Return a file to write: a new one, or the one that was written before."""
        if file.exists() and self._saved.get(kind) != str(file):
            raise InputError(f"{file} exists and was not saved from here: give another name")
        return file

    def _note(self, **saved: str) -> None:
        self._saved |= saved
        self._say(f"saved {', '.join(saved.values())}", "good")

    def _change(self, text: str, *, typed: bool = False) -> None:
        if text != self._texts[self._at]:
            kept = self._texts[: self._at + (0 if typed and self._typed else 1)]
            self._texts = [*kept, text][-_UNDONE:]
            self._at = len(self._texts) - 1
            self._read(typed=typed)

    def _read(self, *, typed: bool = False) -> None:
        """Read the text that is now the current one, and look at its energy."""
        before, self._draft, self._typed = self._draft, read_draft(self._texts[self._at]), typed
        if self._draft.model is not None and self._draft.model is not before.model:
            self._send(_message("model", shown_model(self._draft.model)))
        if self._made_of != _content(self._draft):
            self._forget("")
        elif self._draft.text != before.text:
            self._forget("plan")
        self._look()

    def _forget(self, changed: str) -> None:
        for kind in _AFTER.get(changed, ()):
            self._made.pop(kind, None)
            self._shown.pop(kind, None)

    def _look(self, *, again: bool = False) -> None:
        """Have the atlas made of the energy that the text asks for, if it is another than before."""
        draft, job = self._draft, self._jobs.get("look")
        given = {"model": draft.values.get("model", "lab"), "energy": draft.energy}
        before = self._atlas if job is None else job.given
        same = all(before.get(key) == value for key, value in given.items())
        if draft.energy is None or draft.model is None or (same and not again):
            return
        if job is not None:
            job.kill()
        self._shown.pop("atlas", None)
        self._atlas = given

        def found(atlas: Any) -> None:
            self._atlas = atlas
            self._workers.mark(given["model"])

        failed = partial(self._say, kind="error")
        self._start("look", "atlas", found, failed, given, partial(self._look, again=True))

    def _work(self, what: str, done: Done | None = None, *, failed: Done | None = None, **given: Any) -> None:
        if (job := self._jobs.get("work")) is not None:
            raise InputError(f"{job.what} is under way: wait for it, or cancel it")
        content = _content(self._draft)
        self._forget("" if what == "plan" else what)
        self._made.pop(what, None)
        self._shown.pop(what, None)
        text = self._draft.text

        def found(value: Any) -> None:
            # The itinerary may have been changed in the meantime.
            if content == _content(self._draft) and (what == "plan" or text == self._draft.text):
                self._made[what], self._made_of = value, content

        def missed(sentence: str) -> None:
            self._say(sentence, "error")
            if failed is not None and content == _content(self._draft):
                failed(sentence)
                self._made_of = content

        again = partial(self._work, what, done, failed=failed, **given)
        self._start("work", what, done or found, missed, given, again)

    def _start(
        self, slot: str, what: str, done: Done, failed: Done, given: dict[str, Any], again: Callable[[], None]
    ) -> None:
        def heard(word: str, value: str) -> None:
            if self._jobs.get(slot) is not job:
                return
            if word.startswith("show:"):
                kind = word.removeprefix("show:")
                self._shown[kind] = f'{{"{kind}":{value}}}'
                self._send(self._shown[kind])
                return
            if word == "remark":
                self._say(json.loads(value), "remark")
            elif word != "progress":
                del self._jobs[slot]
            if word == "done":
                done(json.loads(value))
            elif word == "failed":
                failed(json.loads(value))
            elif word == "died":
                self._again = again
                self._say(f"the process of the {what} has ended ({value}); finished parts are kept", "error")
            self._tell()

        self._again = None
        job = self._jobs[slot] = WorkerJob(what, given, heard, again)
        job.start(self._workers)

    def _say(self, text: str, kind: str = "") -> None:
        self._message = {"text": text, "kind": kind}

    def _tell(self) -> None:
        self._send(_message("state", self.state()))


def _message(kind: str, value: Any) -> str:
    return json.dumps({kind: plain(value)}, ensure_ascii=False)


def _names() -> itertools.chain[str]:
    return itertools.chain(["planned"], (f"planned-{k}" for k in itertools.count(2)))


def _content(draft: Draft) -> str:
    """Return what a plan depends on, without its names."""
    return "" if draft.itinerary is None else plan_key(replace(draft.itinerary, name="", title=""))
