"""dpcontrol campaign"""

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from dpcontrol.cli.run_options import KINDS, run_options
from dpcontrol.cli.verbs import Answer, TextTable, file_option, option, verb
from dpcontrol.foundation.errors import InputError
from dpcontrol.foundation.progress import part_of, progress_bar
from dpcontrol.foundation.tables import suggest

if TYPE_CHECKING:
    from dpcontrol.scenes.campaign import Campaign
    from dpcontrol.scenes.standard import StandardScore

WORK = "Work"
SHOWN = 10
"""Failures that are listed for people; all of them are in the file."""


class _Values(click.ParamType):
    """NAME=V1,V2,…: a run setting and the values it takes."""

    name = "name=v1,v2,…"

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> tuple[str, list[Any]]:
        name, equals, values = str(value).partition("=")
        name = name.strip().replace("-", "_")
        if not equals or not all(v.strip() for v in values.split(",")):
            self.fail(f"{value!r} is not NAME=VALUE,VALUE,…, as in mismatch=0.05,0.1", param, ctx)
        if name not in KINDS:
            self.fail(f"{name!r} is not a run setting: {suggest(name, KINDS)}", param, ctx)
        out = []
        for text in values.split(","):
            try:
                out.append(KINDS[name](text.strip()))
            except ValueError:
                self.fail(f"{text.strip()!r} is not a value for {name}", param, ctx)
        return name, out


@verb("campaign", example="dpcontrol campaign outer-turn --runs 200 --mismatch 0.05 --lag 0.005")
@click.argument("itinerary")
@click.option("--runs", type=click.IntRange(min=1), help="Seeds for each case [100; with --standard 8].")
@click.option("--seed-from", type=click.IntRange(min=0), default=0, show_default=True, help="First seed.")
@click.option("--over", type=_Values(), multiple=True, help="Vary a run setting: one case for each value.")
@click.option("--standard", is_flag=True, help="The robustness score: nine kinds of trouble, 21 levels each.")
@option(
    "--path",
    "how",
    type=click.Choice(["compiled", "ticks"]),
    default="compiled",
    show_default=True,
    group=WORK,
    help="Many seeds in lockstep, or the loop itself.",
)
@option("--workers", type=click.IntRange(min=0), default=0, group=WORK, help="Processes [one for each processor].")
@option("--scheduler", default="", metavar="ADDRESS", group=WORK, help="Run on this Dask cluster, as tcp://host:8786.")
@run_options
@file_option("--out", suffix=".parquet", help="Table to write [logs/NAME.parquet].")
def command(
    *,
    itinerary: str,
    runs: int | None,
    seed_from: int,
    over: Sequence[tuple[str, list[Any]]],
    standard: bool,
    how: str,
    workers: int,
    scheduler: str,
    out: Path | None,
    **overrides: Any,
) -> Answer:
    """Run an itinerary with many seeds and report how often it is completed.

    Every case runs the same seeds. Interrupted, it goes on where it was when started again. A failure's seed, given to
    `dpcontrol run --seed` with the same settings, replays it. `--standard` takes every controller of
    `--over controller=…`, or the scene's own.
    """
    from dpcontrol.scenes.campaign import CampaignSettings, cases_of, run_campaign
    from dpcontrol.scenes.itinerary import load_itinerary
    from dpcontrol.scenes.plan import make_plan
    from dpcontrol.scenes.run_options import RunOptions
    from dpcontrol.scenes.standard import standard_cases, standard_scores

    scene = load_itinerary(itinerary)
    settings = CampaignSettings(
        runs=runs or (8 if standard else 100),
        first_seed=seed_from,
        path=how,
        workers=workers,
        scheduler=scheduler,
        # A score needs no list of failures, and so none that are confirmed.
        replayed=0 if standard else CampaignSettings.replayed,
    )
    varied = dict(over)
    if len(varied) != len(over):
        raise InputError("--over: the same setting is given twice; list its values in one, separated by commas")
    if standard:
        own = overrides.pop("controller") or scene.loop.controller.kind
        controllers = varied.pop("controller", [own])
        if varied:
            raise InputError(f"--over {next(iter(varied))}: with --standard only controllers can be varied")
        cases = standard_cases(scene, fixed=RunOptions(**overrides), controllers=controllers)
    else:
        cases = cases_of(scene, fixed=RunOptions(**overrides), over=varied)
    file = out or Path("logs") / f"{scene.name}.parquet"
    with progress_bar("campaign") as progress:
        plan = make_plan(scene, progress=part_of(progress, 0.0, 0.05))
        found = run_campaign(plan, cases, file, settings=settings, progress=part_of(progress, 0.05, 1.0))
    scores = standard_scores(found.results) if standard else ()
    document = {**found.document(), "standard": [score.document() for score in scores]}
    return Answer(document, _text(found, scores))


def _text(found: "Campaign", scores: Sequence["StandardScore"]) -> Iterator[str | TextTable]:
    if scores:
        kinds = list(scores[0].kinds)
        rows = [[s.controller, f"{s.total:.3f}", *(f"{s.kinds[k].rate:.2f}" for k in kinds)] for s in scores]
        yield TextTable(f"Robustness of {found.itinerary}", ["controller", "score", *kinds], rows)
    else:
        rows = [
            [
                r.case.label,
                f"{share.successes} of {share.runs}",
                f"{100 * share.rate:.1f} %",
                f"{100 * share.low:.1f} … {100 * share.high:.1f} %",
            ]
            for r in found.results
            for share in (r.completed,)
        ]
        yield TextTable(f"Campaign of {found.itinerary}", ["case", "completed", "share", "95 % (Wilson)"], rows)
        for first, second, pair in found.pairs:
            yield (
                f"  same seeds: only {first!r} completed {pair.only_first}, only {second!r} {pair.only_second} "
                f"(McNemar p = {pair.p_value:.2g})"
            )
        failures = [row for r in found.results for row in r.failures]
        for failure in failures[:SHOWN]:
            yield f"  seed {failure['seed']}: {failure['reason']}"
        if len(failures) > SHOWN:
            yield f"  … and {len(failures) - SHOWN} more in the file"
    pace = found.simulated_seconds / max(found.seconds, 1e-9)
    took = f"{found.simulated_seconds:.0f} s simulated in {found.seconds:.1f} s"
    yield f"{found.file}  ({took}, {pace:.0f} × real time)"
