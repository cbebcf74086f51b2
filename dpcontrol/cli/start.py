"""The verbs to start with: demo, model, guide, config, cache; and schema."""

import time
from collections.abc import Iterator
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Literal

from dpcontrol.cli.review import score_text, shortfall
from dpcontrol.cli.verbs import (
    FOLDER,
    OUTPUT,
    YES,
    Answer,
    Markdown,
    TextTable,
    argument,
    claim,
    claim_free,
    file_option,
    force_option,
    option,
    table,
    verb,
)  # fmt: skip
from dpcontrol.foundation.progress import part_of, progress_bar

if TYPE_CHECKING:
    from dpcontrol.orbits.lyapunov import Equilibrium
    from dpcontrol.plans.model import Model


@verb("demo", example="dpcontrol demo --itinerary cross")
def demo_command(
    *,
    itinerary: str = option(default="outer-turn", help="Itinerary, by name or path."),
    seed: int = option(default=0, help="Seed of the plant parameters and the initial error."),
    folder: Path = option(
        type=FOLDER, default=Path("logs"), group=OUTPUT, help="Folder for log, recording and picture."
    ),
    force: bool = force_option(),
    yes: bool = YES,
) -> Answer:
    """Plan, run, score and picture one itinerary.

    The default is a full turn of the outer arm at no cost in energy. All steps are computed: Lyapunov orbit, tube,
    connections, and the reference with friction and cart. The closed loop has encoders, an estimator, and a plant that
    differs from the model.
    """

    began = time.perf_counter()
    with progress_bar("demo") as progress:
        progress("loading", 0.0)
        from dpcontrol import api
        from dpcontrol.foundation.parts import installed
        from dpcontrol.judge.of_log import run_view
        from dpcontrol.pages.picture import write_picture
        from dpcontrol.pages.rerun_recording import write_recording

        plan = api.plan(itinerary, yes=yes, progress=part_of(progress, 0.05, 0.5))
        scene = plan.itinerary
        flown = partial(api.run, plan, seed=seed, force=force, progress=part_of(progress, 0.5, 0.75))
        run = claim_free(folder / f"{scene.name}-{seed}.mcap", lambda file: flown(log=file))
        log = run.log.path
        verdict, view = run.score(), run_view(run.log)
        recording = log.with_suffix(".rrd") if installed("rerun") else None
        if recording is not None:
            progress("recording", 0.8)
            write_recording(view, recording)
        progress("picture", 0.85)
        picture = write_picture(view, log.with_suffix(".png"))
    seconds = time.perf_counter() - began
    document = {
        **verdict.document(),
        "recording": recording,
        "picture": picture,
        "seconds": seconds,
    }
    lines = [
        f"{scene.title}: {' '.join(repr(symbol.text) for symbol in plan.content.symbols)}",
        f"  planned: {plan.status}",
        *score_text(verdict),
        f"log        {log}",
        *([f"recording  {recording}     (open it with `rerun {recording}`)"] if recording else []),
        f"picture    {picture}",
        f"{seconds:.1f} s in all; next: `dpcontrol review {log}`, `dpcontrol connect --help`",
    ]
    return Answer(document, lines, shortfall(verdict))


@verb("model", example="dpcontrol model lab", note="MODEL is a name (in ./models or shipped) or a path.")
def model_command(
    *,
    model: str = argument(),
    mjcf: Path | None = file_option(suffix=".xml", help="MuJoCo model to write, with arms and cart (.xml)."),
) -> Answer:
    """Show a model's parameters with units, and its equilibria.

    Equilibria are frictionless, with the pivot at rest.
    """
    from dpcontrol.foundation.document import picked
    from dpcontrol.orbits.lyapunov import equilibria
    from dpcontrol.plans.model import load_model

    loaded = load_model(model)
    if mjcf is not None:
        from dpcontrol.dynamics.mjcf import mjcf_text
        from dpcontrol.foundation.files import write_whole

        write_whole(claim(mjcf), mjcf_text(loaded.arms, name=loaded.name))
    points = equilibria(loaded.system)
    document = {
        "model": loaded.name,
        "title": loaded.title,
        "parameters": {
            name: {"value": value, "unit": unit} for name, (value, unit) in loaded.parameters.named().items()
        },
        "sources": loaded.sources,
        "remarks": loaded.remarks,
        "mjcf": mjcf,
        "equilibria": {name: picked(e, "state", "energy", "eigenvalues", "kind") for name, e in points.items()},
    }
    written = [] if mjcf is None else [f"arms for MuJoCo written to {mjcf}"]
    return Answer(document, [*_text(loaded, points), *written])


@verb("guide", example="dpcontrol guide start", note="`dpcontrol guide` lists the pages in reading order.")
def guide_command(*, topic: str | None = argument()) -> Answer:
    """Show a page of the guide, or list its pages."""
    from dpcontrol.foundation.guide import page, topics

    pages = topics()
    document = {"topics": [{"topic": name, "about": about} for name, about in pages.items()]}
    if topic is None:
        width = max(map(len, pages))
        lines = [f"  {name:{width}}  {about}" for name, about in pages.items()]
        return Answer(document, ["The guide, in reading order:", *lines, "", "`dpcontrol guide TOPIC` shows a page."])
    text = page(topic)
    return Answer({"topic": topic, "text": text, **document}, [Markdown(text)])


@verb("cache", example="dpcontrol cache --clear", note="The folder is $DPCONTROL_CACHE, else ~/.cache/dpcontrol.")
def cache_command(
    *, clear: bool = option(help="Deletion of all entries. They are computed again if needed.")
) -> Answer:
    """List the cached results: plans, atlases, diagrams of connections, machine code.

    Entries are cached by their input, including the program code, and checked when they are read. A damaged entry or
    one of another version is computed again. You can empty the cache at any time. Other files in its folder are kept.
    """
    from dpcontrol.foundation.cache import cache_contents

    found = cache_contents(clear=clear)
    columns = {"kind": "{0[0]}", "entries": "{0[1][0]}", "MB": lambda row: f"{row[1][1] / 1e6:.1f}"}
    return Answer(found.document(), [found.sentence, table("", found.kinds.items(), columns)])


def _text(loaded: "Model", points: "dict[str, Equilibrium]") -> Iterator[str | TextTable]:
    columns = {"parameter": "{0[0]}", "value": "{0[1][0]:.12g}", "unit": "{0[1][1]}"}
    yield table(f"{loaded.name}: {loaded.title}", loaded.parameters.named().items(), columns)
    yield table("equilibria", points.items(), {
        "name": "{0[0]}", f"energy{loaded.unit('J', ' ({})')}": "{0[1].energy:+.10f}", "kind": "{0[1].kind}",
        f"eigenvalues{loaded.unit('1/s', ' ({})')}": lambda row: ", ".join(_eigenvalue(v) for v in row[1].eigenvalues),
    })  # fmt: skip
    for part, source in loaded.sources.items():
        yield f"[{part}] {source}"


def _eigenvalue(value: complex) -> str:
    return f"{value.imag:+.6f}i" if abs(value.imag) > abs(value.real) else f"{value.real:+.6f}"


@verb("config", example="dpcontrol config")
def config_command() -> Answer:
    """Show the defaults of the command line, and where each comes from.

    An option overrides the environment variable, which overrides the file, which overrides the default. The file is
    $XDG_CONFIG_HOME/dpcontrol/config.toml, such as: logs = "~/runs".
    """
    from dpcontrol.foundation.config import config_file, configured, is_there, variable

    found = list(configured())
    document = {
        "file": config_file(),
        "settings": {one.name: {"value": one.value, "source": one.source} for one in found},
    }
    shown = table("", found, {
        "setting": "{.name}", "value": lambda one: str(one.value) or "none", "from": "{.source}",
        "variable": lambda one: variable(one.name), "meaning": "{.help}",
    })  # fmt: skip
    return Answer(document, [f"file  {config_file()}{'' if is_there(config_file()) else ' (not found)'}", shown])


@verb("schema", example="dpcontrol schema itinerary")
def schema_command(*, of: Literal["itinerary", "model"] = argument()) -> Answer:
    """Print the JSON Schema of itineraries or models.

    Editors use it to complete and check files. Save it beside the files, and name it in their first line, such as
    #:schema itinerary.schema.json.
    """
    import json

    from dpcontrol.plans.tables import schema

    document = schema(of)
    return Answer(document, [json.dumps(document, indent=1, ensure_ascii=False)])
