"""dpcontrol campaign"""

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from dpcontrol.cli.output import checked_suffix, json_option, print_json, print_table, progress_bar, reports_failure
from dpcontrol.cli.run_options import RUN_OPTIONS, run_options
from dpcontrol.foundation.errors import InputError
from dpcontrol.foundation.tables import suggest

if TYPE_CHECKING:
    from dpcontrol.foundation.statistics import Share
    from dpcontrol.scenes.campaign import Campaign
    from dpcontrol.scenes.standard import StandardScore

REPLAYED = 4
"""Failures of each job that are confirmed by the loop, tick by tick."""
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
        if name not in RUN_OPTIONS:
            self.fail(f"{name!r} is no run setting: {suggest(name, RUN_OPTIONS)}", param, ctx)
        kind, out = RUN_OPTIONS[name][0], []
        for text in values.split(","):
            try:
                out.append(kind(text.strip()))
            except ValueError:
                self.fail(f"{text.strip()!r} is no value for {name}", param, ctx)
        return name, out


@click.command("campaign", epilog="Example:  dpcontrol campaign outer-turn --runs 200 --mismatch 0.05 --lag 0.005")
@click.argument("itinerary")
@click.option("--runs", type=click.IntRange(min=1), help="Seeds for each case [100; with --standard 8].")
@click.option("--seed-from", type=click.IntRange(min=0), default=0, show_default=True, help="First seed.")
@click.option("--over", type=_Values(), multiple=True, help="Vary a run setting: one case for each value.")
@click.option("--standard", is_flag=True, help="The robustness score: nine kinds of trouble, 21 levels each.")
@click.option("--out", type=click.Path(dir_okay=False, path_type=Path), help="Table to write [logs/NAME.parquet].")
@click.option(
    "--path", "how", type=click.Choice(["compiled", "ticks"]), default="compiled", show_default=True,
    help="Many seeds in lockstep, or the loop itself.",
)  # fmt: skip
@click.option("--workers", type=click.IntRange(min=0), default=0, help="Processes [one for each processor].")
@click.option("--scheduler", default="", metavar="ADDRESS", help="Run on this Dask cluster, as tcp://host:8786.")
@run_options
@json_option
@reports_failure
def command(
    *,
    itinerary: str,
    runs: int | None,
    seed_from: int,
    over: Sequence[tuple[str, list[Any]]],
    standard: bool,
    out: Path | None,
    how: str,
    workers: int,
    scheduler: str,
    as_json: bool,
    **overrides: Any,
) -> None:
    """Run an itinerary with many seeds and say how often it is completed.

    Every case runs the same seeds. Interrupted, it goes on where it was when started again. A failure's seed, given to
    `dpcontrol run --seed` with the same settings, replays it. `--standard` takes every controller of
    `--over controller=…`, or the scene's own.
    """
    from dpcontrol.foundation.progress import part_of
    from dpcontrol.scenes.campaign import CampaignSettings, cases_of, run_campaign
    from dpcontrol.scenes.itinerary import load_itinerary
    from dpcontrol.scenes.plan import make_plan
    from dpcontrol.scenes.run_options import RunOptions
    from dpcontrol.scenes.standard import standard_cases, standard_scores

    scene = load_itinerary(itinerary)
    file = out or Path("logs") / f"{scene.name}.parquet"
    checked_suffix(file, ".parquet", option="--out")
    # A score needs no list of failures, and so none that are confirmed.
    settings = CampaignSettings(
        runs=runs or (8 if standard else 100), first_seed=seed_from, path=how, workers=workers, scheduler=scheduler,
        replayed=0 if standard else REPLAYED,
    )  # fmt: skip
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
    with progress_bar("campaign") as progress:
        plan = make_plan(scene, progress=part_of(progress, 0.0, 0.05))
        found = run_campaign(plan, cases, file, settings=settings, progress=part_of(progress, 0.05, 1.0))
    scores = standard_scores(found.results) if standard else ()
    if as_json:
        print_json({**found.document(), "standard": [score.document() for score in scores]})
    else:
        _print(found, scores)


def _percent(share: "Share") -> tuple[str, str]:
    return f"{100 * share.rate:.1f} %", f"{100 * share.low:.1f} … {100 * share.high:.1f} %"


def _print(found: "Campaign", scores: Sequence["StandardScore"]) -> None:
    if scores:
        kinds = list(scores[0].kinds)
        rows = [[s.controller, f"{s.total:.3f}", *(f"{s.kinds[k].rate:.2f}" for k in kinds)] for s in scores]
        print_table(f"Robustness of {found.itinerary}", ["controller", "score", *kinds], rows)
    else:
        rows = [
            [r.case.label, f"{r.completed.successes} of {r.completed.runs}", *_percent(r.completed)]
            for r in found.results
        ]
        print_table(f"Campaign of {found.itinerary}", ["case", "completed", "share", "95 % (Wilson)"], rows)
        for first, second, pair in found.pairs:
            print(
                f"  same seeds: only {first!r} completed {pair.only_first}, only {second!r} {pair.only_second} "
                f"(McNemar p = {pair.p_value:.2g})"
            )
        failures = [row for r in found.results for row in r.failures]
        for failure in failures[:SHOWN]:
            print(f"  seed {failure['seed']}: {failure['reason']}")
        if len(failures) > SHOWN:
            print(f"  … and {len(failures) - SHOWN} more in the file")
    pace = found.simulated_seconds / max(found.seconds, 1e-9)
    print(f"{found.file}  ({found.simulated_seconds:.0f} s simulated in {found.seconds:.1f} s, {pace:.0f} × real time)")
