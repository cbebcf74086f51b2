"""Where a campaign's rows live: one tidy Parquet file, and beside it the finished jobs of one that was interrupted.

Every finished job is kept as NAME.parquet.parts/KEY.parquet, whole or absent, its key the hash of all it depends on: a
campaign that is started again takes what is there and runs the rest. When all jobs are done their rows become one file,
in the order of the jobs, and the parts are removed.
"""

import json
import shutil
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

from dpcontrol.foundation.errors import InputError
from dpcontrol.foundation.files import whole_file
from dpcontrol.scenes.campaign_jobs import COLUMNS, Row

METADATA = b"dpcontrol.campaign"
"""Key of the file's own metadata: JSON with the settings, version and commit."""


def _schema(extra: Sequence[str], metadata: Mapping[str, Any] | None) -> Any:
    import pyarrow as pa

    kinds = {"string": pa.string(), "int64": pa.int64(), "int32": pa.int32(), "double": pa.float64()}
    kinds["bool"] = pa.bool_()
    fields = [pa.field(name, kinds[kind]) for name, kind in COLUMNS.items()]
    fields += [pa.field(name, pa.float64()) for name in extra]
    return pa.schema(fields, metadata={METADATA: json.dumps(metadata or {}).encode()})


def write_rows(
    path: Path, rows: Iterable[Row], *, extra: Sequence[str] = (), metadata: Mapping[str, Any] | None = None
) -> None:
    """Write rows to a Parquet file, whole or not at all; extra: names of further columns of numbers.

    Raises:
        InputError: the file cannot be written.
    """
    import pyarrow as pa
    import pyarrow.parquet as pq

    table = pa.Table.from_pylist(list(rows), schema=_schema(extra, metadata))
    with whole_file(path, suffix=".parquet") as temporary:
        pq.write_table(table, temporary, compression="zstd")


def read_rows(path: Path) -> tuple[list[Row], dict[str, Any]]:
    """Return a campaign file's rows, and its metadata.

    Raises:
        InputError: the file is missing, damaged or no campaign.
    """
    import pyarrow as pa
    import pyarrow.parquet as pq

    try:
        table = pq.read_table(path)
    except FileNotFoundError as error:
        raise InputError(f"{path} does not exist; `dpcontrol campaign ITINERARY --out {path}` makes it") from error
    except (pa.ArrowException, OSError) as error:
        first = str(error).splitlines()[0]
        raise InputError(f"{path} cannot be read as Parquet ({first}); run the campaign again") from error
    missing = [name for name in COLUMNS if name not in table.column_names]
    if missing:
        raise InputError(f"{path} is no campaign of dpcontrol: it has no column {missing[0]!r}")
    metadata = (table.schema.metadata or {}).get(METADATA, b"{}")
    return table.to_pylist(), json.loads(metadata)


class Parts:
    """The finished jobs of one campaign file."""

    def __init__(self, path: Path, *, extra: Sequence[str]) -> None:
        self.folder = path.with_name(path.name + ".parts")
        self._extra = tuple(extra)

    def load(self, key: str) -> list[Row] | None:
        """Return a finished job's rows; None where there are none, or they are damaged."""
        file = self.folder / f"{key}.parquet"
        if not file.is_file():
            return None
        try:
            return read_rows(file)[0]
        except InputError:
            return None

    def keep(self, key: str, rows: Sequence[Row]) -> None:
        """Keep a job's rows.

        Raises:
            InputError: the folder cannot be written.
        """
        write_rows(self.folder / f"{key}.parquet", rows, extra=self._extra)

    def remove(self) -> None:
        """Remove the folder."""
        shutil.rmtree(self.folder, ignore_errors=True)
