"""dpcontrol figures"""

from functools import cache
from pathlib import Path
from textwrap import fill

import click

from dpcontrol.cli.output import json_option, print_json, progress_bar, reports_failure


@click.command("figures", epilog="Example:  dpcontrol figures tubes heteroclinics --out pictures")
@click.argument("names", nargs=-1, metavar="[NAME]...")
@click.option(
    "--out",
    type=click.Path(file_okay=False, path_type=Path),
    default=Path("figures"),
    show_default=True,
    help="Folder for the pictures and captions.json.",
)
@json_option
@reports_failure
def command(*, names: tuple[str, ...], out: Path, as_json: bool) -> None:
    """Draw the paper's computational figures from atlases: each a PNG with a caption and what differs from the paper.

    Names: energy-landscape, families, tubes, homoclinics-low, homoclinics-high, heteroclinics, branches, graph,
    double-homoclinics, triple-homoclinics, colour-wheels, three-body. All are drawn where none is named. Atlases are
    kept by content.
    """
    from dpcontrol.review.figures.page import Gallery
    from dpcontrol.review.figures.registry import CAPTIONS, draw_figures
    from dpcontrol.scenes.atlas import AtlasSettings, make_atlas
    from dpcontrol.scenes.branches import make_branches
    from dpcontrol.scenes.model import load_model

    model = cache(load_model)
    gallery = Gallery(
        system=lambda name: model(name).system,
        atlas=lambda name, energy, hits: make_atlas(model(name), energy, settings=AtlasSettings(hits=hits)).atlas,
        branches=lambda name, source, target, told: make_branches(model(name), source, target, progress=told),
    )
    with progress_bar("figures") as progress:
        drawn = draw_figures(names, gallery, out, progress=progress)
    if as_json:
        print_json(
            {
                "figures": [
                    {"name": d.name, "file": str(d.file), "caption": d.caption, "differs": d.differs,
                     "seconds": d.seconds}
                    for d in drawn
                ],
                "captions": str(out / CAPTIONS),
                "status": f"{len(drawn)} figures drawn",
            }
        )  # fmt: skip
        return
    for d in drawn:
        click.echo(f"{d.file}")
        click.echo(fill(d.caption, 110, initial_indent="  ", subsequent_indent="  "))
        click.echo(fill(f"Differs from the paper: {d.differs}", 110, initial_indent="  ", subsequent_indent="  "))
    click.echo(f"captions  {out / CAPTIONS}")
