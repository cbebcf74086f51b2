"""Tables of campaigns carry Parquet's checksums."""

from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from dpcontrol.foundation.errors import InputError
from dpcontrol.judge.campaign import campaign_summary

FLIPS = 100
ROWS = pa.table(
    {
        "seed": list(range(40)),
        "completed": [k % 3 > 0 for k in range(40)],
        "reason": [f"symbol {k}" for k in range(40)],
        "max_cart_position": np.random.default_rng(1).uniform(size=40),
    }
)


def test_a_flipped_bit_in_the_values_of_a_table_is_refused_in_one_sentence(tmp_path: Path) -> None:
    folder = tmp_path / "runs.parquet"
    folder.mkdir()
    file = folder / "0.parquet"
    pq.write_table(ROWS, file, compression="zstd", write_page_checksum=True)
    data = file.read_bytes()
    values = len(data) - 8 - int.from_bytes(data[-8:-4], "little")  # before Parquet's footer, which has no checksum
    random = np.random.default_rng(5)
    for place in np.linspace(4, values - 1, FLIPS).astype(int):
        spoilt = bytearray(data)
        spoilt[place] ^= 1 << random.integers(8)
        file.write_bytes(spoilt)
        try:
            table = pq.read_table(file, page_checksum_verification=True)
        except (OSError, pa.ArrowException):
            with pytest.raises(InputError, match="is damaged") as refused:
                campaign_summary(folder)
            assert "\n" not in str(refused.value)
        else:
            assert table.equals(ROWS)
