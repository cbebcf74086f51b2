"""dpcontrol atlas"""

import shutil
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from dpcontrol.cli.output import (
    Hits,
    checked_suffix,
    json_option,
    multiplier_text,
    print_json,
    print_table,
    progress_bar,
    reports_failure,
)
from dpcontrol.foundation.errors import GoalMissed

if TYPE_CHECKING:
    from dpcontrol.scenes.atlas import FoundAtlas
    from dpcontrol.walks.atlas import Atlas


@click.command("atlas", epilog="Example:  dpcontrol atlas lab --energy 0.2      then: dpcontrol review FILE")
@click.argument("model")
@click.option("--energy", required=True, type=float, help="Energy in J, zero at the pivot's height.")
@click.option(
    "--hits",
    type=Hits(),
    help="How-manieth crossing of the section: of both tubes, or N,M of the unstable and the stable one. "
    "[default: for each kind the first at which they meet, up to 2]",
)
@click.option("--fresh", is_flag=True, help="Compute anew even if the atlas is cached.")
@click.option("--out", type=click.Path(dir_okay=False, path_type=Path), help="Also write the atlas to this .npz.")
@json_option
@reports_failure
def command(
    *, model: str, energy: float, hits: tuple[int, int] | None, fresh: bool, out: Path | None, as_json: bool
) -> None:
    """Compute all of one energy: every Lyapunov orbit, their tubes, every connection between them, rotating orbits.

    The atlas is one file (orbits, cuts, connections with their flights), kept by content: it is computed once. Look at
    it with `dpcontrol review FILE`. Exits with 1 if crossings of the tubes' cuts did not converge.
    """
    from dpcontrol.foundation.files import whole_file
    from dpcontrol.scenes.atlas import AtlasSettings, make_atlas
    from dpcontrol.scenes.model import load_model

    if out is not None:
        checked_suffix(out, ".npz", option="--out")
    with progress_bar("atlas") as progress:
        found = make_atlas(load_model(model), energy, settings=AtlasSettings(hits=hits), fresh=fresh, progress=progress)
    atlas, file = found.atlas, found.file
    if out is not None:
        with whole_file(out, suffix=".npz") as temporary:
            shutil.copyfile(file, temporary)
        file = out
    if as_json:
        print_json(_document(found, file))
    else:
        _print(atlas)
        click.echo(f"file  {file}{' (cached)' if found.cached else ''}")
    if not atlas.complete:
        raise GoalMissed(f"the atlas of {model} at {energy:g} J is not complete: {atlas.status}")


def _document(found: "FoundAtlas", file: Path) -> dict[str, Any]:
    from dpcontrol.walks.atlas import connection_document, orbit_document, rotating_document

    atlas = found.atlas
    return {
        "energy": atlas.energy,
        "model": atlas.model,
        "orbits": [orbit_document(orbit) for orbit in atlas.orbits],
        "rotating_orbits": [rotating_document(orbit) for orbit in atlas.rotating_orbits],
        "count": len(atlas.connections),
        "connections": [{**connection_document(c), "from": c.source, "to": c.target} for c in atlas.connections],
        "kinds": [
            {
                "from": kind.source,
                "to": kind.target,
                "section": kind.section,
                "hits": kind.hits,
                "count": kind.count,
                "complete": kind.complete,
                "by_reversal": kind.by_reversal,
                "open_cuts": [
                    {"branch": f"{tube} {branch:+d}", "phase_interval": interval, "reason": reason}
                    for tube, branch, interval, reason in kind.open_ends
                ],
                "status": kind.status,
            }
            for kind in atlas.kinds
        ],
        "absent": [{"saddle": saddle, "reason": reason} for saddle, reason in atlas.absent],
        "complete": atlas.complete,
        "file": str(file),
        "cached": found.cached,
        "seconds": dict(atlas.seconds),
        "status": atlas.status,
    }


def _print(atlas: "Atlas") -> None:
    print_table(
        f"{atlas.model} at {atlas.energy:g} J: Lyapunov orbits",
        ("about", "period (s)", "multiplier", "closure"),
        [
            (o.name, f"{o.period:.12g}", f"{o.floquet_multipliers[0].real:.10g}", f"{o.residual:.0e}")
            for o in atlas.orbits
        ],
    )
    if atlas.rotating_orbits:
        print_table(
            "orbits that turn one arm forward",
            ("arm", "period (s)", "stability", "multipliers", "closure"),
            [
                (
                    ("inner", "outer")[o.arm - 1],
                    f"{o.period:.12g}",
                    o.kind,
                    "  ".join(multiplier_text(complex(m), 8) for m in o.floquet_multipliers),
                    f"{o.residual:.0e}",
                )
                for o in atlas.rotating_orbits
            ],
        )
    print_table(
        "connections",
        ("from → to", "section", "hits", "count", "cuts"),
        [
            (
                f"{k.source} → {k.target}",
                k.section,
                f"{k.hits[0]}, {k.hits[1]}",
                str(k.count),
                "closed" if k.complete else "open",
            )
            for k in atlas.kinds
        ],
    )
    for c in atlas.connections:
        symmetric = ", symmetric" if c.symmetric else ""
        click.echo(f"  {c.name}   {c.transversality_angle:.2f}°, residual {c.residual:.0e}{symmetric}")
    click.echo(atlas.status)
    seconds = ", ".join(f"{name} {value:.2f} s" for name, value in atlas.seconds.items())
    click.echo(f"{seconds} (when it was made)")
