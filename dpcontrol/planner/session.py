"""State of one page, which survives a reload of the page.

A session has slots for jobs in separate processes. The slot "look" computes the atlas at the displayed energy, and a
new request replaces the previous one. The slot "work" runs one job on the itinerary at a time.
"""

import asyncio
import itertools
import json
import shutil
import tempfile
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field
from functools import partial, partialmethod
from pathlib import Path
from typing import Any

from dpcontrol.foundation.document import plain
from dpcontrol.foundation.errors import InputError
from dpcontrol.foundation.files import write_whole
from dpcontrol.planner.draft import Draft, first_text, read_draft
from dpcontrol.planner.shown import shown_model
from dpcontrol.planner.workers import Workers

_UNDONE = 200
"""Largest number of changes that can be undone."""
_ITINERARIES, _LOGS = Path("itineraries"), Path("logs")
_KEYS = {"": {"energy", "start", "finish", "wraps"}, "run": {"mismatch", "lag", "pushes"}}
"""Keys with controls on the page, by table."""
_OUTDATED = {
    "plan": ("plan", "run", "seeds", "page"),
    "settings": ("run", "seeds", "page"),
    "run": ("run", "page"),
    "seeds": ("seeds",),
    "page": ("page",),
}
"""Results that become outdated, by the item that changes."""


@dataclass
class WorkerJob:
    """A job with its progress.

    Attributes:
        kind: name of the job.
        seconds: likely duration, s, 0 if unknown.
        again: function that starts it again.
        what: current step.
        done: completed share, 0 to 1.
        task: task that runs it.
    """

    kind: str
    seconds: float
    again: Callable[[], None]
    what: str
    done: float = 0.0
    task: asyncio.Task[None] = field(init=False)


class PageSession:
    """State of one page, whose JSON messages `broadcast` sends to the browser's windows that show it."""

    def __init__(self, workers: Workers, model: str, broadcast: Callable[[Iterable[Any], str], None]) -> None:
        """Start a page with the first text for a model.

        Args:
            workers: processes that run the page's jobs.
            model: name or path of the model.
            broadcast: sends a message to several windows.
        """
        self._workers, self._broadcast = workers, broadcast
        # Connections of websockets, one for each window.
        self.windows: set[Any] = set()
        # Folder for the logs of runs, which `close` deletes.
        self._folder = Path(tempfile.mkdtemp(prefix="dpcontrol-planner-"))
        # Texts that can be undone or redone, the index of the present one, and True if it was changed by typing.
        self._texts, self._at, self._typed = [first_text(model)], 0, False
        self._draft, model_message = _parsed(self._texts[0])
        free_names = itertools.chain(["planned"], (f"planned-{k}" for k in itertools.count(2)))
        self._name = next(name for name in free_names if not (_ITINERARIES / f"{name}.toml").exists())
        # Result of the atlas's job, and results of the other jobs by their names, such as "plan".
        self._atlas: dict[str, Any] = {}
        self._made: dict[str, Any] = {}
        # Contents of the files that the page saved, and their paths by kind, such as "toml".
        self._written: dict[Path, bytes] = {}
        self._saved: dict[str, str] = {}
        # Number of the last command of the page that was executed.
        self._acknowledged = 0
        # The last message of each kind, and the current jobs by slot.
        self._shown: dict[str, str] = {}
        self._jobs: dict[str, WorkerJob] = {}
        # Function that starts the last cancelled or broken job again.
        self._again: Callable[[], None] | None = None
        # Commands of all windows are executed one after the other.
        self._order = asyncio.Lock()
        self._set_message("")
        self._take(self._draft, model_message)

    def everything(self) -> list[str]:
        """Return all messages that a newly loaded page needs to show the present state."""
        # The count of commands restarts, because the old value belongs to the previous page.
        self._acknowledged = 0
        return [*self._shown.values(), _message("state", self.state())]

    def state(self) -> dict[str, Any]:
        """Return the page's data other than motions and drawings: draft, results, the current job and the message."""
        job = self._jobs.get("work") or self._jobs.get("look")
        draft, symbols = self._draft.document(), self._atlas.get("symbols", {})
        known_symbols = {*self._atlas.get("names", ()), *symbols}
        return {
            **draft,
            "energy": draft["energy"] if draft["energy"] is not None else self._atlas.get("energy"),
            "names": [symbols.get(text, text) for text in draft["walk"]],
            "unknown": [k for k, text in enumerate(draft["walk"]) if known_symbols and text not in known_symbols],
            "name": self._name,
            **{kind: self._made.get(kind) for kind in ("plan", "run", "seeds")},
            "saved": self._saved or None,
            "busy": {key: getattr(job, key) for key in ("what", "done", "kind", "seconds")} if job else None,
            "working": "work" in self._jobs,
            "message": self._message,
            "retry": self._again is not None,
            "undo": self._at > 0,
            "redo": self._at < len(self._texts) - 1,
            "ack": self._acknowledged,
        }

    async def command(self, text: str) -> None:
        """Execute a page's command after all previous ones and send the new state.

        Errors become messages.

        Args:
            text: JSON object with the action `do`, its number `n` and the action's arguments.
        """
        async with self._order:
            number = self._acknowledged
            self._set_message("")
            try:
                arguments = dict(json.loads(text))
                number = int(arguments.pop("n", 0))
                action = arguments.pop("do")
                if action in _EDITS:
                    await self._change(partial(_EDITS[action], **arguments), typed=action == "toml")
                elif (task := getattr(self, f"do_{action}")(**arguments)) is not None:
                    await task
            except InputError as error:
                self._set_message(str(error), "error")
            except (TypeError, ValueError, OverflowError, LookupError, AttributeError, RecursionError) as error:
                self._set_message(f"invalid command: {error}", "error")
            self._acknowledged = number
            self._send_state()

    def do_name(self, name: str) -> None:
        """Set the name under which itinerary, log and film are saved.

        Args:
            name: at most 80 characters that are safe in a file name.
        """
        if not 0 < len(name) <= 80 or not name.isprintable() or set(name) & set(r"\/:*?<>|\"") or name[0] in ".- ":
            raise InputError(f"name = {name[:80]!r}: use letters, digits and dashes")
        self._name = name

    def do_save(self) -> None:
        """Save the itinerary as a TOML file, and the log of its last run, if there is one."""
        files = {"toml": self._target(_ITINERARIES / f"{self._name}.toml")}
        contents = {"toml": self._needed("text").encode()}
        if (run := self._made.get("run")) is not None:
            files["log"] = self._target(_LOGS / f"{self._name}-{run['seed']}.mcap")
            contents["log"] = Path(run["log"]).read_bytes()
        for kind, file in files.items():
            write_whole(file, contents[kind])
            self._note(kind, file)
        saved_files = " and ".join(map(str, files.values()))
        self._set_message(f"saved {saved_files}; run it with `dpcontrol run {self._name}`", "good")

    def do_film(self) -> None:
        """Start the job that writes a film of the last run beside its log."""
        self._needed("log")
        film = self._target(_LOGS / f"{self._name}-{self._made['run']['seed']}.gif")
        self._work("film", "log", film=str(film))

    def do_cancel(self) -> None:
        """Cancel the current job; its cached results remain."""
        if slot := next((slot for slot in ("work", "look") if slot in self._jobs), ""):
            job = self._jobs.pop(slot)
            job.task.cancel()
            self._again = job.again
            self._set_message(f"cancelled: {job.what}")

    def do_retry(self) -> None:
        """Restart the last job whose process ended."""
        if self._again is not None:
            self._again()

    def close(self) -> None:
        """Stop all jobs and delete unsaved files."""
        for job in self._jobs.values():
            job.task.cancel()
        shutil.rmtree(self._folder, ignore_errors=True)

    async def _step(self, by: int) -> None:
        """Return to the previous text (`by` = -1) or to the next one (+1), and show it."""
        self._at = min(max(self._at + by, 0), len(self._texts) - 1)
        self._typed = False
        self._take(*await asyncio.to_thread(_parsed, self._texts[self._at]))

    def _needed(self, what: str) -> str:
        """Return the input that a job needs: for "text" the itinerary's text, for "log" the path of the last run's log.

        Raises:
            InputError: the text has a mistake, or there is no run yet.
        """
        log = self._made.get("run", {}).get("log", "")
        if problem := self._draft.problem if what == "text" else "" if log else "no run exists yet: press Run":
            raise InputError(problem)
        return self._draft.text if what == "text" else log

    def _target(self, file: Path) -> Path:
        """Return a path that may be written: of a new file, or of one that is still as this page saved it.

        Raises:
            InputError: the file is another one, which must not be overwritten.
        """
        if file.exists() and file.read_bytes() != self._written.get(file):
            raise InputError(f"{file} exists, and is not as this page saved it: choose another name")
        return file

    def _note(self, kind: str, file: Path) -> None:
        """Remember that the page saved a file of a kind ("toml", "log" or "film"), so that it may overwrite it."""
        self._written[file], self._saved[kind] = file.read_bytes(), str(file)

    # These commands restore the previous and the next text.
    do_undo, do_redo = partialmethod(_step, -1), partialmethod(_step, 1)

    async def _change(self, edit: Callable[[Draft], str], *, typed: bool = False) -> None:
        """Replace the text by an edit of the draft, as a step that can be undone.

        Consecutive changes by typing (`typed`) are one step. Edit and parsing run in a thread because a long walk takes
        seconds.
        """
        text = await asyncio.to_thread(edit, self._draft)
        if text != self._texts[self._at]:
            draft, model_message = await asyncio.to_thread(_parsed, text)
            earlier_texts = self._texts[: self._at + (0 if typed and self._typed else 1)]
            self._texts = [*earlier_texts, text][-_UNDONE:]
            self._at, self._typed = len(self._texts) - 1, typed
            self._take(draft, model_message)

    def _take(self, draft: Draft, shown: str) -> None:
        """Replace the draft, forget outdated results, and request the atlas of its energy.

        `shown` is the message with the draft's model, "" if the model could not be loaded.
        """
        former, self._draft = self._draft, draft
        if shown:
            self._show("model", shown)
        if draft.text != former.text:
            self._forget("settings" if draft.content == former.content else "plan")
        self._look()

    def _show(self, kind: str, message: str) -> None:
        """Send a message of this kind to all windows unless it was the last one, and keep it for new windows."""
        if self._shown.get(kind) != message:
            self._shown[kind] = message
            self._broadcast(self.windows, message)

    def _forget(self, changed: str) -> None:
        """Drop the results that a change makes outdated, by the names in `_OUTDATED`."""
        for kind in _OUTDATED.get(changed, ()):
            self._made.pop(kind, None)
            self._shown.pop(kind, None)

    def _look(self, *, again: bool = False) -> None:
        """Start the job of the atlas for the text's energy, unless it is current; `again` starts it in any case."""
        draft = self._draft
        arguments = {"model": draft.values.get("model", "lab"), "energy": draft.energy}
        is_current = all(self._atlas.get(key) == value for key, value in arguments.items())
        if draft.energy is None or draft.model is None or (is_current and not again):
            return
        self._shown.pop("atlas", None)
        self._atlas = arguments

        def done(atlas: Any) -> None:
            """Store the job's result as the atlas of the page."""
            self._atlas = atlas

        self._start("look", WorkerJob("atlas", 0.0, partial(self._look, again=True), "atlas"), arguments, done)

    def _work(self, kind: str, needs: str, **given: Any) -> None:
        """Start a job on the itinerary, whose result is kept unless the itinerary has changed in the meantime.

        Args:
            kind: name of the job.
            needs: name of its input, "text" or "log", see `_needed`.
            **given: its other arguments.

        Raises:
            InputError: another job is running, or the input does not exist yet.
        """
        if (job := self._jobs.get("work")) is not None:
            raise InputError(f"{job.what} is running: wait for it, or cancel it")
        given[needs], draft = self._needed(needs), self._draft
        self._forget(kind)

        def done(value: Any) -> None:
            """Keep the result of the job, or tell the user that a file was written or the viewer was opened."""
            if kind == "rerun":
                self._set_message("the viewer is open", "good")
            elif kind == "film":
                self._note(kind, Path(given[kind]))
                self._set_message(f"saved {given[kind]}", "good")
            elif draft.content == self._draft.content and (kind == "plan" or draft.text == self._draft.text):
                self._made[kind] = value

        def failed(failure: dict[str, Any]) -> None:
            """Keep the cause for which there is no plan, with wraps that work if they fit the draft's walk."""
            if kind == "plan" and draft.content == self._draft.content:
                fits = len(failure["wraps"] or ()) == len(draft.wraps)
                self._made[kind] = {"converged": False, **failure, "wraps": failure["wraps"] if fits else None}

        job = WorkerJob(kind, draft.seconds if kind == "plan" else 0.0, partial(self._work, kind, needs, **given), kind)
        self._start("work", job, given, done, failed)

    # These commands start the jobs of the same names.
    do_plan, do_seeds = partialmethod(_work, "plan", "text"), partialmethod(_work, "seeds", "text")
    do_page, do_rerun = partialmethod(_work, "page", "log"), partialmethod(_work, "rerun", "log")

    def do_run(self, seed: int = 0) -> None:
        """Run the plan, which is computed first if it is not cached.

        Args:
            seed: seed of the random numbers, 0 to 2147483647.
        """
        self._work("run", "text", seed=seed, folder=str(self._folder))

    def _start(
        self,
        slot: str,
        job: WorkerJob,
        given: dict[str, Any],
        done: Callable[[Any], None] = lambda value: None,
        failed: Callable[[Any], None] = lambda value: None,
    ) -> None:
        """Start a job, which replaces the one in its slot.

        Args:
            slot: "look" or "work".
            job: the job.
            given: arguments of the job.
            done: called with the job's result.
            failed: called with the cause of its failure.
        """

        def on_report(word: str, value: str) -> None:
            """Handle one report of the job's process, unless another job has replaced it.

            `word` is "progress", "remark", "show:KIND" for the page, "done", "failed" or "died", and `value` its JSON;
            of "died" it is the exit status in words.
            """
            if self._jobs.get(slot) is not job:
                return
            if word.startswith("show:"):
                kind = word.removeprefix("show:")
                self._show(kind, f'{{"{kind}":{value}}}')
                return
            if word == "progress":
                job.what, job.done = json.loads(value)
            elif word == "remark":
                self._set_message(json.loads(value), "remark")
            else:
                del self._jobs[slot]
            if word == "done":
                done(json.loads(value))
            elif word == "failed":
                failure = json.loads(value)
                self._set_message(failure["status"], "error")
                failed(failure)
            elif word == "died":
                self._again = job.again
                self._set_message(f"the process of the {job.kind} ended ({value}); finished parts are cached", "error")
            self._send_state()

        if (former := self._jobs.get(slot)) is not None:
            former.task.cancel()
        self._again = None
        self._jobs[slot] = job
        job.task = asyncio.get_running_loop().create_task(self._workers.run(job.kind, given, on_report))

    def _set_message(self, text: str, kind: str = "") -> None:
        """Set the sentence that the page shows, with its kind: "", "good", "remark" or "error"."""
        self._message = {"text": text, "kind": kind}

    def _send_state(self) -> None:
        """Send the page's state to all its windows."""
        self._broadcast(self.windows, _message("state", self.state()))


def _message(kind: str, value: Any) -> str:
    """Return a JSON message for the page, an object whose only key is the message's kind."""
    # A text with an error may have dates in place of numbers, and half characters, which only their escapes can send.
    return json.dumps({kind: plain(value)}, default=str)


def _set(draft: Draft, values: dict[str, Any], table: str = "") -> str:
    """Return the draft's text with new values of keys that have controls on the page.

    Args:
        draft: the draft.
        values: new values by key.
        table: table of the keys, "" for the top level.

    Raises:
        InputError: a key has no control on the page.
    """
    if not values.keys() <= _KEYS[table]:
        raise InputError(f"{', '.join(values)}: the page has no control for these keys; edit the TOML")
    return draft.changed(table, values)


_EDITS: dict[str, Callable[..., str]] = {
    "model": lambda _, name: first_text(str(name)),
    "toml": lambda _, text: str(text),
    "set": _set,
    "append": Draft.appended,
    "shorten": lambda draft: draft.changed("", {"walk": draft.walk[:-1], "wraps": draft.wraps[:-1]}),
    "wraps": Draft.wrapped,
}
"""Commands that return a new text from the draft and the command's arguments."""


def _parsed(text: str) -> tuple[Draft, str]:
    """Return the draft of a text, and its model's message or ""."""
    draft = read_draft(text)
    # Both take time for a long walk, and are kept.
    _ = draft.stops, draft.content
    return draft, "" if draft.model is None else _message("model", shown_model(draft.model))
