"""Tables of campaigns carry a checksum: a single flipped bit is refused, and tables without one are read."""

from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from dpcontrol.foundation.errors import InputError
from dpcontrol.judge.campaign import campaign_summary
from dpcontrol.runs.campaign import _write

FLIPS = 400
ROWS = pa.table(
    {
        "itinerary": ["turn"] * 40,
        "controller": ["tvlqr"] * 40,
        "seed": list(range(40)),
        "mismatch": np.linspace(0, 0.1, 40),
        "completed": [k % 3 > 0 for k in range(40)],
        "reason": [f"symbol {k}" for k in range(40)],
        "max_cart_position": np.random.default_rng(1).uniform(size=40),
    }
)


def written(folder: Path) -> Path:
    """Return a table as campaigns write it."""
    _write(folder / "runs.parquet", ROWS)
    return folder / "runs.parquet"


def test_a_flipped_bit_anywhere_in_a_table_is_refused_in_one_sentence(tmp_path: Path) -> None:
    whole = written(tmp_path).read_bytes()
    file, random = tmp_path / "flipped.parquet", np.random.default_rng(5)
    for place in np.linspace(0, len(whole) - 1, FLIPS).astype(int):
        spoilt = bytearray(whole)
        spoilt[place] ^= 1 << random.integers(8)
        file.write_bytes(spoilt)
        with pytest.raises(InputError) as refused:
            campaign_summary(file)
        assert "\n" not in str(refused.value)
        assert "is damaged" in str(refused.value)


def test_a_sealed_table_is_an_ordinary_parquet_file(tmp_path: Path) -> None:
    there = pq.read_table(written(tmp_path))
    assert there.equals(ROWS)
    assert campaign_summary(tmp_path / "runs.parquet").share.successes == 26


def test_a_table_of_an_earlier_version_has_no_seal_and_is_read(tmp_path: Path) -> None:
    pq.write_table(ROWS, tmp_path / "old.parquet", compression="zstd")
    assert campaign_summary(tmp_path / "old.parquet").share.runs == 40


def test_a_table_that_was_changed_on_purpose_is_read_without_its_seal(tmp_path: Path) -> None:
    changed = pq.read_table(written(tmp_path)).slice(0, 30)
    pq.write_table(changed, tmp_path / "some.parquet")
    with pytest.raises(InputError, match="if it was changed on purpose, remove its metadata"):
        campaign_summary(tmp_path / "some.parquet")
    pq.write_table(changed.replace_schema_metadata(None), tmp_path / "some.parquet")
    assert campaign_summary(tmp_path / "some.parquet").share.runs == 30
