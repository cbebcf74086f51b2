"""dpcontrol atlas"""

import shutil
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING

import click

from dpcontrol.cli.verbs import Answer, Hits, TextTable, file_option, multiplier_text, verb
from dpcontrol.foundation.progress import progress_bar

if TYPE_CHECKING:
    from dpcontrol.walks.atlas import Atlas


@verb("atlas", example="dpcontrol atlas lab --energy 0.2", note="then: dpcontrol review FILE")
@click.argument("model")
@click.option("--energy", required=True, type=float, help="Energy in J, zero at the pivot's height.")
@click.option(
    "--hits",
    type=Hits(),
    help="Which crossings of the section count: the k-th of both tubes, or N,M for the unstable and the stable one. "
    "[default: for each kind the first at which they meet, up to 2]",
)
@click.option("--fresh", is_flag=True, help="Compute anew even if the atlas is cached.")
@file_option("--out", suffix=".npz", help="Also write the atlas to this .npz.")
def command(*, model: str, energy: float, hits: tuple[int, int] | None, fresh: bool, out: Path | None) -> Answer:
    """Compute all of one energy: every Lyapunov orbit, their tubes, every connection between them, rotating orbits.

    The atlas is one file (orbits, cuts, connections with their flights), kept by content: it is computed once. Look at
    it with `dpcontrol review FILE`. Exits with 1 if the list of connections may be incomplete.
    """
    from dpcontrol.foundation.files import whole_file
    from dpcontrol.scenes.atlas import AtlasSettings, make_atlas
    from dpcontrol.scenes.model import load_model

    with progress_bar("atlas") as progress:
        found = make_atlas(load_model(model), energy, settings=AtlasSettings(hits=hits), fresh=fresh, progress=progress)
    atlas, file = found.atlas, found.file
    if out is not None:
        with whole_file(out, suffix=".npz") as temporary:
            shutil.copyfile(file, temporary)
        file = out
    missed = "" if atlas.complete else f"the atlas of {model} at {energy:g} J is not complete: {atlas.status}"
    document = {**atlas.document(), "file": str(file), "cached": found.cached}
    return Answer(document, [*_text(atlas), f"file  {file}{' (cached)' if found.cached else ''}"], missed)


def _text(atlas: "Atlas") -> Iterator[str | TextTable]:
    yield TextTable(
        f"{atlas.model} at {atlas.energy:g} J: Lyapunov orbits",
        ("about", "period (s)", "multiplier", "closure"),
        [
            (o.name, f"{o.period:.12g}", f"{o.floquet_multipliers[0].real:.10g}", f"{o.residual:.0e}")
            for o in atlas.orbits
        ],
    )
    if atlas.rotating_orbits:
        yield TextTable(
            "orbits that turn one arm forward",
            ("arm", "period (s)", "stability", "multipliers", "closure"),
            [
                (
                    ("inner", "outer")[o.arm - 1],
                    f"{o.period:.12g}",
                    o.kind,
                    "  ".join(multiplier_text(m, 8) for m in o.floquet_multipliers),
                    f"{o.residual:.0e}",
                )
                for o in atlas.rotating_orbits
            ],
        )
    rows = [
        (f"{k.source} → {k.target}", k.section, f"{k.hits[0]}, {k.hits[1]}", str(k.count),
         "closed" if k.complete else "open")
        for k in atlas.kinds
    ]  # fmt: skip
    yield TextTable("connections", ("from → to", "section", "hits", "count", "cuts"), rows)
    for c in atlas.connections:
        symmetric = ", symmetric" if c.symmetric else ""
        yield f"  {c.name}   {c.transversality_angle:.2f}°, residual {c.residual:.0e}{symmetric}"
    yield atlas.status
    seconds = ", ".join(f"{name} {value:.2f} s" for name, value in atlas.seconds.items())
    yield f"{seconds} (when it was made)"
