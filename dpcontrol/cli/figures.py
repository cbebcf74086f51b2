"""dpcontrol figures"""

from functools import cache
from pathlib import Path
from textwrap import fill

import click

from dpcontrol.cli.verbs import OUTPUT, Answer, option, verb
from dpcontrol.foundation.progress import progress_bar


@verb("figures", example="dpcontrol figures tubes heteroclinics --out pictures")
@click.argument("names", nargs=-1, metavar="[NAME]...")
@option(
    "--out",
    type=click.Path(file_okay=False, path_type=Path),
    default=Path("figures"),
    show_default=True,
    group=OUTPUT,
    help="Folder for the pictures and captions.json.",
)
def command(*, names: tuple[str, ...], out: Path) -> Answer:
    """Draw the paper's computational figures from atlases: each a PNG with a caption and what differs from the paper.

    Names: energy-landscape, families, tubes, homoclinics-low, homoclinics-high, heteroclinics, branches, graph,
    double-homoclinics, triple-homoclinics, colour-wheels, three-body. All are drawn where none is named. Atlases are
    kept by content.
    """
    from dpcontrol.foundation.documents import picked
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
    document = {
        "figures": [{"file": str(d.file), **picked(d, "name", "caption", "differs", "seconds")} for d in drawn],
        "captions": str(out / CAPTIONS),
        "status": f"{len(drawn)} figures drawn",
    }
    lines = [
        "\n".join([str(d.file), _paragraph(d.caption), _paragraph(f"Differs from the paper: {d.differs}")])
        for d in drawn
    ]
    return Answer(document, [*lines, f"captions  {out / CAPTIONS}"])


def _paragraph(text: str) -> str:
    return fill(text, 110, initial_indent="  ", subsequent_indent="  ")
