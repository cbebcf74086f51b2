"""Options and files act as documented: suffixes, byte-order marks, columns, exit codes, keys."""

import re
from pathlib import Path

import numpy as np
import pytest
from command_line import dpcontrol

from dpcontrol.foundation.errors import InputError
from dpcontrol.pages.layout import new_figure, save_figure


@pytest.fixture(autouse=True)
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    return tmp_path


@pytest.mark.parametrize("name", ["swing.csv", "swing.parquet", "s3:swing.parquet", "file:swing.parquet"])
def test_a_table_without_rates_needs_no_mapping(name: str, folder: Path) -> None:
    time = np.arange(400) / 200
    columns = {"time": time, "angle_1": np.sin(time), "angle_2": np.cos(time)}
    file = folder / name
    if file.suffix == ".csv":
        np.savetxt(file, np.stack(list(columns.values()), 1), delimiter=",", header=",".join(columns), comments="")
    else:
        import pyarrow as pa
        import pyarrow.parquet as pq

        with file.open("wb") as stream:
            pq.write_table(pa.table(columns), stream)
    ended = dpcontrol("import", name)
    assert ended.code == 0, ended.stderr
    assert "rates    none" in ended.stdout


def test_the_missing_one_of_two_rates_is_named(folder: Path) -> None:
    (folder / "swing.csv").write_text("time,angle_1,angle_2,rate_1\n0,0,0,0\n")
    ended = dpcontrol("import", "swing.csv")
    assert ended.code == 2
    assert "rate_2" in ended.message


def test_a_byte_order_mark_at_the_start_of_a_file_is_no_part_of_it(shipped_text: dict[str, str]) -> None:
    Path("mine.toml").write_text(shipped_text["lab"], encoding="utf-8-sig")
    ended = dpcontrol("model", "mine.toml")
    assert ended.code == 0, ended.stderr


@pytest.mark.parametrize(
    "line",
    [
        "run outer-turn --out turn.txt",
        "run --from turn.mcap --out turn.npz",
        "import swing.csv --out swing.csv.txt",
        "replay turn.mcap --out turn",
        "recover turn.mcap --out turn.txt",
        "campaign outer-turn --out table.csv",
        "report turn.mcap --picture page.jpg",
        "review turn.mcap --picture page.jpg",
        "plan outer-turn --out turn.mcap",
    ],
)
def test_a_suffix_of_another_format_is_rejected(line: str, folder: Path) -> None:
    ended = dpcontrol(*line.split())
    assert ended.code == 2
    assert "choose a name that ends in ." in ended.message
    assert list(folder.iterdir()) == []


def test_a_figure_is_saved_in_the_format_that_its_name_promises(folder: Path) -> None:
    with pytest.raises(InputError, match=r"page\.jpg: a picture is a \.png or \.pdf file"):
        save_figure(new_figure(2, 2), "page.jpg")
    assert list(folder.iterdir()) == []


def test_help_of_connect_documents_the_exit_code_of_an_incomplete_list() -> None:
    search = ("connect", "lab", "--from", "down-up", "--to", "down-up", "--energy", "-0.07", "--longest", "1")
    ended = dpcontrol(*search, "--json")
    assert ended.document["complete"] is (ended.code == 0)
    shown = " ".join(dpcontrol("connect", "--help").stdout.split())
    assert "The exit code is 1 if the list may be incomplete (`complete` in --json). With --name" in shown


def test_a_cart_at_its_stop_reports_the_angle_of_the_arms() -> None:
    troubles = ("--mismatch", "0.1", "--initial-error", "0.05", "--travel", "0.1")
    ended = dpcontrol("run", "outer-turn", "--controller", "tvlqr", *troubles)
    assert ended.code == 1
    assert re.search(r"must brake now to stay on the track, with an angle 0\.\d+ rad from the reference", ended.message)


def test_the_choices_of_a_missing_argument_are_in_its_sentence() -> None:
    ended = dpcontrol("schema")
    assert ended.code == 2
    assert ended.message.startswith(
        "dpcontrol: Missing argument '{itinerary|model}'. Choose from: itinerary, model; see"
    )
