"""The package's evidence on levels, gathered anew for every shipped scene and held against what is kept.

DPCONTROL_STORE_EVIDENCE=1 replaces it. Takes a quarter of an hour.
"""

import os
from pathlib import Path

import pytest
from evidence_text import evidence_text

from dpcontrol.bench.levels import gather
from dpcontrol.plans.itinerary import load_itinerary
from dpcontrol.runs import evidence as shipped
from dpcontrol.runs.evidence import Evidence, known_evidence

pytestmark = pytest.mark.benchmark

ROOT = Path(__file__).parents[2]
SEEDS = 5


@pytest.fixture(scope="module")
def gathered() -> list[Evidence]:
    names = sorted(path.stem for path in (ROOT / "itineraries").glob("*.toml"))
    return [gather(load_itinerary(name), seeds=SEEDS)[0] for name in names]


def test_the_levels_that_scenes_need_are_those_kept(gathered):
    if os.environ.get("DPCONTROL_STORE_EVIDENCE") == "1":
        kept = Path(shipped.__file__).with_name("level_evidence.toml")
        kept.write_text(evidence_text(gathered))
        known_evidence.cache_clear()
    known = {found.scene: found for found in known_evidence().values()}
    for found in gathered:
        kept_levels = known[found.scene].reference_level, known[found.scene].plant_level
        assert (found.reference_level, found.plant_level) == kept_levels, found.scene
