"""State of one page, which survives a reload of the page.

A session has two slots for long jobs in separate processes. The slot "look" computes the atlas at the displayed energy,
and a new request replaces the previous one. The slot "work" runs one job on the itinerary at a time.
"""

import asyncio
import itertools
import json
import shutil
import tempfile
from collections.abc import Callable
from functools import partial, partialmethod
from pathlib import Path
from typing import Any

from dpcontrol.foundation.document import plain
from dpcontrol.foundation.errors import InputError
from dpcontrol.foundation.files import write_whole
from dpcontrol.planner.draft import Draft, first_text, read_draft
from dpcontrol.planner.shown import shown_model
from dpcontrol.planner.workers import WorkerJob, Workers

_UNDONE = 200
"""Largest number of changes that can be undone."""
_ITINERARIES, _LOGS = Path("itineraries"), Path("logs")
_KEYS = {"": {"energy", "start", "finish"}, "run": {"mismatch", "lag", "pushes"}}
"""Keys with controls on the page, by table."""
_OUTDATED = {"plan": ("plan", "run", "seeds", "page"), "settings": ("run", "seeds", "page"), "run": ("run", "page"),
             "seeds": ("seeds",), "page": ("page",)}  # fmt: skip
"""Results that become outdated, by the item that changes."""

Done = Callable[[Any], None]


class PageSession:
    """State of one page, which sends JSON messages by `send`."""

    def __init__(self, workers: Workers, model: str, send: Callable[[str], None]) -> None:
        self._workers, self._send = workers, send
        self._folder = Path(tempfile.mkdtemp(prefix="dpcontrol-planner-"))
        self._texts, self._at, self._typed = [first_text(model)], 0, False
        self._draft, shown = _parsed(self._texts[0])
        names = itertools.chain(["planned"], (f"planned-{k}" for k in itertools.count(2)))
        self._name = next(name for name in names if not (_ITINERARIES / f"{name}.toml").exists())
        self._atlas: dict[str, Any] = {}
        self._made: dict[str, Any] = {}
        self._made_of, self._written = "", b""
        self._saved: dict[str, str] = {}
        self._message = {"text": "", "kind": ""}
        self._acknowledged = 0
        self._shown: dict[str, str] = {}
        self._jobs: dict[str, WorkerJob] = {}
        self._again: Callable[[], None] | None = None
        self._order = asyncio.Lock()
        self._take(self._draft, shown)

    def everything(self) -> list[str]:
        """Return all messages for a newly loaded page."""
        # The count of commands restarts, because the old value belongs to the previous page.
        self._acknowledged = 0
        return [*self._shown.values(), _message("state", self.state())]

    def state(self) -> dict[str, Any]:
        """Return the page's data other than motions and drawings."""
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
                given = dict(json.loads(text))
                number = int(given.pop("n", 0))
                do = given.pop("do")
                if do in _EDITS:
                    await self._change(partial(_EDITS[do], **given), typed=do == "toml")
                elif (waiting := getattr(self, f"do_{do}")(**given)) is not None:
                    await waiting
            except InputError as error:
                self._set_message(str(error), "error")
            except (TypeError, ValueError, OverflowError, KeyError, AttributeError, RecursionError) as error:
                self._set_message(f"invalid command: {error}", "error")
            self._acknowledged = number
            self._send_state()

    async def do_accept(self) -> None:
        """Set the wraps that the failed plan proposes."""
        if not (wraps := (self._made.get("plan") or {}).get("wraps")):
            raise InputError("no wraps are proposed for this itinerary: plan it first")
        await self._change(lambda draft: draft.changed("", {"wraps": wraps}))

    def do_plan(self) -> None:
        """Plan the itinerary."""
        self._work("plan", text=self._whole().text)

    def do_run(self, seed: int = 0) -> None:
        """Run the plan, which is computed first if it is not cached.

        Args:
            seed: seed of the random numbers, 0 to 2147483647.
        """
        if not 0 <= int(seed) < 2**31:
            raise InputError(f"seed = {seed}: must be 0 to 2147483647")
        log = str(self._folder / f"run-{int(seed)}.mcap")
        self._work("run", text=self._whole().text, seed=int(seed), log=log)

    def do_seeds(self) -> None:
        """Run the plan with twenty seeds."""
        self._work("seeds", text=self._whole().text)

    def do_page(self) -> None:
        """Draw the overview of the run."""
        self._work("page", log=self._run()["log"])

    def do_rerun(self) -> None:
        """Open the run in the viewer."""
        self._work("rerun", lambda _: self._set_message("the viewer is open", "good"), log=self._run()["log"])

    def do_film(self) -> None:
        """Write a film of the run."""
        film = self._target(_LOGS / f"{self._name}-{self._run()['seed']}.gif", "film")
        self._work("film", lambda _: self._note(film=str(film)), log=self._run()["log"], film=str(film))

    def do_name(self, name: str) -> None:
        """Set the name of saved files.

        Args:
            name: at most 80 characters that are safe in a file name.
        """
        if not 0 < len(name) <= 80 or not name.isprintable() or set(name) & set(r"\/:*?<>|\"") or name[0] in ".- ":
            raise InputError(f"name = {name[:80]!r}: use letters, digits and dashes")
        self._name = name

    def do_save(self) -> None:
        """Save the itinerary and the log of its run, if any."""
        text, run = self._whole().text, self._made.get("run")
        toml = self._target(_ITINERARIES / f"{self._name}.toml", "toml")
        log = None if run is None else self._target(_LOGS / f"{self._name}-{run['seed']}.mcap", "log")
        write_whole(toml, text)
        self._written = toml.read_bytes()
        self._note(toml=str(toml))
        if log is not None and run is not None:
            write_whole(log, Path(run["log"]).read_bytes())
            self._note(log=str(log))
        self._set_message(
            f"saved {toml}{f' and {log}' if log else ''}; run it with `dpcontrol run {self._name}`", "good"
        )

    def do_cancel(self) -> None:
        """Cancel the current job; its cached results remain."""
        if slot := next((slot for slot in ("work", "look") if slot in self._jobs), ""):
            job = self._jobs.pop(slot)
            job.kill()
            self._again = job.again
            self._set_message(f"cancelled: {job.what}")

    def do_retry(self) -> None:
        """Restart the last job whose process ended."""
        if self._again is not None:
            self._again()

    def close(self) -> None:
        """Stop all jobs and delete unsaved files."""
        for job in self._jobs.values():
            job.kill()
        self._jobs.clear()
        shutil.rmtree(self._folder, ignore_errors=True)

    async def _step(self, by: int) -> None:
        at = min(max(self._at + by, 0), len(self._texts) - 1)
        draft, shown = await asyncio.to_thread(_parsed, self._texts[at])
        self._at, self._typed = at, False
        self._take(draft, shown)

    def _whole(self) -> Draft:
        if self._draft.itinerary is None:
            wrong = self._draft.mistake
            raise InputError(wrong.message if wrong else "the walk has no symbol yet: click a connection")
        return self._draft

    def _run(self) -> dict[str, Any]:
        if self._made.get("run") is None:
            raise InputError("no run exists yet: press Run")
        return self._made["run"]

    def _target(self, file: Path, kind: str) -> Path:
        """Return the path, of a new file or one saved here."""
        if file.exists() and (
            self._saved.get(kind) != str(file) or (kind == "toml" and file.read_bytes() != self._written)
        ):
            raise InputError(f"{file} exists, and is not as this page saved it: choose another name")
        return file

    def _note(self, **saved: str) -> None:
        self._saved |= saved
        self._set_message(f"saved {', '.join(saved.values())}", "good")

    # These commands restore the previous and the next text.
    do_undo, do_redo = partialmethod(_step, -1), partialmethod(_step, 1)

    async def _change(self, edit: Callable[[Draft], str], *, typed: bool = False) -> None:
        """Replace the text, which is edited and parsed in a thread because a long walk takes seconds."""
        text = await asyncio.to_thread(edit, self._draft)
        if text != self._texts[self._at]:
            draft, shown = await asyncio.to_thread(_parsed, text)
            kept = self._texts[: self._at + (0 if typed and self._typed else 1)]
            self._texts = [*kept, text][-_UNDONE:]
            self._at, self._typed = len(self._texts) - 1, typed
            self._take(draft, shown)

    def _take(self, draft: Draft, shown: str) -> None:
        """Replace the draft, show its model and request the atlas of its energy."""
        before, self._draft = self._draft, draft
        if shown:
            self._show("model", shown)
        if self._made_of != draft.content:
            self._forget("plan")
        elif draft.text != before.text:
            self._forget("settings")
        self._look()

    def _show(self, kind: str, message: str) -> None:
        if self._shown.get(kind) != message:
            self._shown[kind] = message
            self._send(message)

    def _forget(self, changed: str) -> None:
        for kind in _OUTDATED.get(changed, ()):
            self._made.pop(kind, None)
            self._shown.pop(kind, None)

    def _look(self, *, again: bool = False) -> None:
        """Start the atlas for the text's energy, unless it is current."""
        draft = self._draft
        given = {"model": draft.values.get("model", "lab"), "energy": draft.energy}
        same = all(self._atlas.get(key) == value for key, value in given.items())
        if draft.energy is None or draft.model is None or (same and not again):
            return
        if (job := self._jobs.get("look")) is not None:
            job.kill()
        self._shown.pop("atlas", None)
        self._atlas = given

        def found(atlas: Any) -> None:
            self._atlas = atlas
            self._workers.mark(given["model"])

        def missed(failure: dict[str, Any]) -> None:
            self._set_message(failure["status"], "error")

        self._start("look", "atlas", found, missed, given, partial(self._look, again=True))

    def _work(self, what: str, done: Done | None = None, **given: Any) -> None:
        if (job := self._jobs.get("work")) is not None:
            raise InputError(f"{job.what} is running: wait for it, or cancel it")
        content = self._draft.content
        self._forget(what)
        text = self._draft.text

        def found(value: Any) -> None:
            # The itinerary may have changed in the meantime.
            if content == self._draft.content and (what == "plan" or text == self._draft.text):
                self._made[what], self._made_of = value, content

        def missed(failure: dict[str, Any]) -> None:
            self._set_message(failure["status"], "error")
            if what == "plan" and content == self._draft.content:
                fits = failure["wraps"] and len(failure["wraps"]) == len(self._draft.wraps)
                self._made_of = content
                self._made[what] = {"converged": False, **failure, "wraps": failure["wraps"] if fits else None}

        again = partial(self._work, what, done, **given)
        self._start("work", what, done or found, missed, given, again)

    def _start(
        self, slot: str, what: str, done: Done, failed: Done, given: dict[str, Any], again: Callable[[], None]
    ) -> None:
        def on_report(word: str, value: str) -> None:
            if self._jobs.get(slot) is not job:
                return
            if word.startswith("show:"):
                self._show(kind := word.removeprefix("show:"), f'{{"{kind}":{value}}}')
                return
            if word == "remark":
                self._set_message(json.loads(value), "remark")
            elif word != "progress":
                del self._jobs[slot]
            if word == "done":
                done(json.loads(value))
            elif word == "failed":
                failed(json.loads(value))
            elif word == "died":
                self._again = again
                self._set_message(f"the process of the {what} ended ({value}); finished parts are cached", "error")
            self._send_state()

        self._again = None
        job = self._jobs[slot] = WorkerJob(what, given, on_report, again)
        job.start(self._workers)

    def _set_message(self, text: str, kind: str = "") -> None:
        self._message = {"text": text, "kind": kind}

    def _send_state(self) -> None:
        self._send(_message("state", self.state()))


def _message(kind: str, value: Any) -> str:
    # A text with an error may have dates in place of numbers, and half characters, which only their escapes can send.
    return json.dumps({kind: plain(value)}, default=str)


def _set(draft: Draft, values: dict[str, Any], table: str = "") -> str:
    """Return the text with new values of keys that have controls on the page."""
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
