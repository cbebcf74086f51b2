"""A campaign's table as numbers: shares of success and failures.

Each row is one run. Shares come with Wilson's 95 % interval (`foundation.statistics`). Only the column `completed` is
required. Optional columns are itinerary, controller, estimator, mismatch, symbols_completed, symbols_total, cause,
ending, rms_tracking_error (rad), max_cart_position (m). A table with kind and level comes from the standard score: its
groups are formed by kind of trouble, its levels over all kinds together. Cases with equal values in these columns are
distinguished by `case`. Other columns are ignored.
"""

import json
from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass, field
from itertools import pairwise
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from dpcontrol.foundation.document import Documented, document_of, picked
from dpcontrol.foundation.errors import InputError
from dpcontrol.foundation.files import checked_size
from dpcontrol.foundation.parts import Later
from dpcontrol.foundation.shown import Shown
from dpcontrol.foundation.statistics import Share, share_of

if TYPE_CHECKING:
    import pyarrow as pa
else:
    pa = Later("pyarrow")
dataset = Later("pyarrow.dataset")

METADATA = b"dpcontrol.campaign"
"""Key of a table's metadata: JSON with the itinerary, the model, the settings and the version."""
_WHAT = ("itinerary", "controller", "estimator")
"""Columns that form groups if their values differ."""
_KIND, _LEVEL, _CASE = "kind", "level", "case"
_APART, _BINS = 21, 6
"""Most values shown individually, and the number of bins for more."""


@dataclass(frozen=True)
class Group:
    """Runs with equal values in some columns, and a mismatch or a level of trouble between two bounds.

    Attributes:
        names: value of each of these columns.
        share: share of completed runs.
        low: least mismatch or level.
        high: greatest mismatch or level.
    """

    names: dict[str, str]
    share: Share
    low: float = -np.inf
    high: float = np.inf

    @property
    def label(self) -> str:
        """The group's values as one line, for tables and pictures."""
        return self._line()

    @property
    def family(self) -> str:
        """The group's values without the kind of trouble, as one line.

        Groups of all kinds of trouble share it, and so have a common colour and a common curve over the level.
        """
        return self._line(without=_KIND)

    def _line(self, *, without: str = "") -> str:
        """Return the group's values as one line, without the column `without` and without those that its case repeats.

        A case is a text of settings, such as "controller=tvlqr, lag=0.01". Without any value, the line is "all runs".
        """
        case_settings = self.names.get(_CASE, "").split(", ")
        parts = (
            value
            for column, value in self.names.items()
            if column != without and f"{column}={value}" not in case_settings
        )
        return " · ".join(parts) or "all runs"


@dataclass(frozen=True, eq=False)
class CampaignSummary(Shown, Documented):
    """Success rates and causes of failure in a campaign's table.

    Attributes:
        path: of the table.
        runs: rows with a known outcome.
        unknown: other rows.
        share: of all runs.
        groups: by itinerary, controller and estimator if these differ, by kind of trouble, and by case if these and
            the mismatch do not distinguish cases.
        axis: "mismatch", or "level" of the standard score.
        levels: by family and mismatch or level; empty if it does not vary.
        failed_symbols: (family, symbol from 1, number of runs that failed at it), symbol 0 if unknown.
        reasons: number of failed runs by cause, the most frequent first.
        record: itinerary, model, version and settings by case, as the campaign wrote them; empty if unknown.
    """

    path: Path
    runs: int
    unknown: int
    share: Share
    groups: tuple[Group, ...]
    axis: str
    levels: tuple[Group, ...]
    failed_symbols: tuple[tuple[str, int, int], ...]
    reasons: tuple[tuple[str, int], ...]
    record: Mapping[str, Any] = field(default_factory=dict)

    @property
    def status(self) -> str:
        """The result in one line."""
        return self.share.sentence() + (f"; {self.unknown} without a verdict" if self.unknown else "")

    @property
    def good(self) -> bool | None:
        """True if nine of ten runs complete, False below half.

        The result is None in between.
        """
        return self.share.likely

    def document(self) -> dict[str, Any]:
        """Return the output of `dpcontrol report --json` for a campaign."""
        return {
            "campaign": str(self.path),
            **picked(self, "status", "runs", "unknown"),
            **_share_document(self.share),
            "groups": [{**group.names, **_share_document(group.share)} for group in self.groups],
            self.axis: [
                {"group": level.label, "from": level.low, "to": level.high, **_share_document(level.share)}
                for level in self.levels
            ],
            "failures": {
                "by_symbol": [
                    {"group": label, "symbol": symbol or None, "runs": count}
                    for label, symbol, count in self.failed_symbols
                ],
                "by_reason": [{"reason": reason, "runs": count} for reason, count in self.reasons],
            },
        }


def _share_document(share: Share) -> dict[str, Any]:
    """Return counts, rate and interval of a share under the keys of the JSON document."""
    return document_of(share, "completed=successes of=runs rate low high")


def campaign_table(path: Path) -> "pa.Table":
    """Return the rows of a campaign's table.

    Args:
        path: folder of the table's Parquet files.

    Raises:
        InputError: the folder is missing, or holds no Parquet files or damaged ones.
    """
    if not path.is_dir():
        problem = "is a file, as of version 0.2; now each table is a folder" if path.exists() else "does not exist"
        raise InputError(f"the campaign {path} {problem}: give the folder that `dpcontrol campaign` wrote")
    options = dataset.ParquetFragmentScanOptions(page_checksum_verification=True)
    try:
        files = [str(file) for file in sorted(path.glob("*.parquet"))]
        rows = dataset.dataset(files, format=dataset.ParquetFileFormat(default_fragment_scan_options=options))
        checked_size(8.0 * rows.count_rows() * len(rows.schema))
        return rows.to_table()
    except (pa.ArrowException, OSError, ValueError) as error:
        reason = str(error).splitlines()[0]
        raise InputError(
            f"{path} is not a campaign's table, or is damaged: {reason}; run the campaign again"
        ) from error


def campaign_summary(path: Path) -> CampaignSummary:
    """Return the summary of a campaign's table.

    Args:
        path: folder of the table.

    Raises:
        InputError: the table is missing or damaged, or has no runs or no column of completed runs.
    """
    return summary_of(campaign_table(path), path)


def summary_of(rows: "pa.Table", path: Path) -> CampaignSummary:
    """Return the summary of a campaign's table: shares of completed runs by group and level, and causes of failure.

    Args:
        rows: a row for each run.
        path: place of the table, for messages and titles.

    Raises:
        InputError: the table has no runs, or no column of completed runs.
    """
    if "completed" not in rows.column_names:
        columns = ", ".join(sorted(rows.column_names)) or "no columns"
        raise InputError(
            f"{path} has no column of completed runs, only {columns}; give a table of `dpcontrol campaign`"
        )
    judged_rows = rows.filter(rows["completed"].is_valid())
    if not judged_rows.num_rows:
        raise InputError(f"{path} holds no runs with a verdict; run the campaign again")
    table = judged_rows.to_pydict()
    completed = np.array(table["completed"], dtype=bool)
    families = [name for name in _WHAT if name in table and len(set(table[name])) > 1]
    standard = _KIND in table and _LEVEL in table
    compared_columns = [table[name] for name in (*_WHAT, "mismatch") if name in table]
    distinct_cases = set(zip(*compared_columns, strict=True)) or {()}
    # Groups and levels do not separate all cases.
    if (
        not standard
        and _CASE in table
        and len(set(zip(*compared_columns, table[_CASE], strict=True))) > len(distinct_cases)
    ):
        families.append(_CASE)
    axis = _LEVEL if standard else "mismatch"
    causes = table.get("cause") or table.get("ending") or [""] * len(completed)
    groups = _groups(table, [*families, _KIND] if standard else families, completed)
    family_groups = _groups(table, families, completed)
    return CampaignSummary(
        path=path,
        runs=judged_rows.num_rows,
        unknown=rows.num_rows - judged_rows.num_rows,
        share=share_of(completed),
        groups=tuple(group for group, _ in groups),
        axis=axis,
        levels=_levels(_numbers(table, axis), family_groups, completed),
        failed_symbols=_symbols(table, family_groups, completed),
        reasons=tuple(Counter(str(causes[k] or "not named") for k in np.flatnonzero(~completed)).most_common()),
        record=json.loads((rows.schema.metadata or {}).get(METADATA, b"{}")),
    )


Rows = NDArray[np.bool_]
"""True (K,) for the rows of a table that belong to a group, or for completed runs."""


def _groups(table: dict[str, list[Any]], columns: list[str], done: Rows) -> list[tuple[Group, Rows]]:
    """Return the groups of runs with equal values in columns, in the order of these, and the rows (K,) of each group.

    `table` has the values (K,) of each column. Rows are True for the runs of the group, and `done` (K,) is True for
    completed runs. Without columns, all runs are one group.
    """
    keys = [tuple(str(table[name][k]) for name in columns) for k in range(len(done))]
    members_by_key = {key: np.array([other == key for other in keys]) for key in sorted(set(keys))}
    return [
        (Group(dict(zip(columns, key, strict=True)), share_of(done[members])), members)
        for key, members in members_by_key.items()
    ]


def _numbers(table: dict[str, list[Any]], name: str) -> NDArray[np.float64] | None:
    """Return the column `name` of a table as numbers (K,), or None if it has no numbers; nan for missing values."""
    values = np.array(table.get(name, []), dtype=float)
    return values if np.isfinite(values).any() else None


def _levels(values: NDArray[np.float64] | None, groups: list[tuple[Group, Rows]], done: Rows) -> tuple[Group, ...]:
    """Return the share of completed runs of each group at each mismatch or level, for the curve over it.

    More than `_APART` different values are put into `_BINS` bins of equal counts. The result is empty if the values do
    not vary; pairs without runs are left out.

    Args:
        values: mismatch or level (K,) of each run, None if the table has none.
        groups: groups, each with True (K,) for its runs.
        done: True (K,) for completed runs.
    """
    if values is None or len(distinct := np.unique(values[np.isfinite(values)])) < 2:
        return ()
    if len(distinct) <= _APART:
        bounds = [(float(value), float(value)) for value in distinct]
    else:
        edges = np.unique(np.quantile(values[np.isfinite(values)], np.linspace(0, 1, _BINS + 1)))
        bounds = [(float(low_edge), float(np.nextafter(high_edge, -np.inf))) for low_edge, high_edge in pairwise(edges)]
        bounds[-1] = (bounds[-1][0], float(edges[-1]))
    return tuple(
        Group(group.names, share_of(done[rows]), low, high)
        for group, members in groups
        for low, high in bounds
        if (rows := members & (values >= low) & (values <= high)).any()
    )


def _symbols(
    table: dict[str, list[Any]], groups: list[tuple[Group, Rows]], done: Rows
) -> tuple[tuple[str, int, int], ...]:
    """Return the number of failed runs of each group by the symbol at which they failed.

    An entry has the group's label, the number of the symbol from 1, or 0 if it is unknown, and the number of runs.

    Args:
        table: values (K,) of each column of the table, by name.
        groups: groups, each with True (K,) for its runs.
        done: True (K,) for completed runs.
    """
    completed_symbols, all_symbols = (_numbers(table, name) for name in ("symbols_completed", "symbols_total"))
    symbols = np.zeros(len(done)) if completed_symbols is None else np.nan_to_num(completed_symbols + 1)
    if all_symbols is not None:
        # All symbols were done, but end, wraps or limits failed: the failure is after the last.
        symbols = np.fmin(symbols, all_symbols + 1)
    counts = ((group.label, Counter(symbols[members & ~done].astype(int).tolist())) for group, members in groups)
    return tuple(
        (label, symbol, count) for label, group_counts in counts for symbol, count in sorted(group_counts.items())
    )
