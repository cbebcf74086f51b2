"""The README's table of success: how often each itinerary is completed by the controller as it comes.

Those that begin at rest, as on a rig, come first. Prints a row of the table for each; `-k up-up` makes one alone.
"""

import sys

import pytest

from dpcontrol.scenes.campaign import CampaignSettings, cases_of, run_campaign
from dpcontrol.scenes.itinerary import load_itinerary
from dpcontrol.scenes.plan import make_plan
from dpcontrol.scenes.run_options import RunOptions

pytestmark = pytest.mark.benchmark

ITINERARIES = (
    "turn-from-rest", "cross-from-rest", "up-up", "two-energies", "round-trip-from-rest",
    "outer-turn", "cross", "double-turn", "triple-turn", "turn-cross-turn-return", "round-trip",
)  # fmt: skip
BENCH = RunOptions(
    lag=0.005, command_noise=0.3, initial_error=0.05, zero_error=0.02, counts=40_000, travel=0.8
)  # fmt: skip
BARS = {0.05: 0.985, 0.1: 0.98, 0.2: 0.96, 0.3: 0.9}
"""By the mismatch: at ±5 % the least lower end of Wilson's interval, at more of it the least share."""
RUNS, FIRST_SEED = 400, 70_000


@pytest.mark.parametrize("name", ITINERARIES)
def test_a_shipped_itinerary_is_completed_by_the_controller_as_it_comes(name: str) -> None:
    scene = load_itinerary(name)
    cases = cases_of(scene, fixed=BENCH, over={"mismatch": list(BARS)})
    settings = CampaignSettings(runs=RUNS, first_seed=FIRST_SEED, replayed=0)
    shares = [result.completed for result in run_campaign(make_plan(scene), cases, settings=settings, yes=True).results]
    row = " | ".join(f"{share.rate:.1%} ({100 * share.low:.1f})".replace("%", " %") for share in shares)
    sys.stdout.write(f"\n| {name} | {row} |\n")
    for share, (mismatch, bar) in zip(shares, BARS.items(), strict=True):
        reached = share.low if mismatch == min(BARS) else share.rate
        assert reached >= bar, f"{name}, ±{mismatch:.0%}: {reached:.1%} is below {bar:.1%}"
