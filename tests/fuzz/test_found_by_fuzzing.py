"""Errors found by the fuzz tests, each with its call."""

import json
import os
import subprocess
import warnings
from collections.abc import Mapping
from dataclasses import replace
from io import BytesIO
from pathlib import Path
from types import MappingProxyType, SimpleNamespace

import numpy as np
import pytest
from command_line import PROGRAM, dpcontrol, dpcontrol_program
from mcap.reader import McapReader, make_reader
from mcap.writer import Writer

from dpcontrol.foundation.errors import InputError
from dpcontrol.identification.replay import filter_settings
from dpcontrol.judge.of_log import run_view, true_extras
from dpcontrol.judge.score import score
from dpcontrol.logs import LogWriter, read_log
from dpcontrol.pages.layout import Page, new_figure, save_figure
from dpcontrol.recordings.recording import Recording, write_samples
from dpcontrol.references.reference import load_reference, save_reference

REST = 'model = "lab"\nstart = "hold"\nhold = "down-down"\nseconds = 0.5\n[controller]\nkind = "lqr"\n'


@pytest.fixture(autouse=True)
def in_a_folder_of_its_own(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    Path("rest.toml").write_text(REST)


def test_a_mismatch_of_minus_zero_is_none() -> None:
    assert dpcontrol("run", "rest.toml", "--mismatch=-0").code == 0


def test_a_seed_of_four_hundred_digits_is_refused() -> None:
    ended = dpcontrol("run", "rest.toml", f"--seed={400 * '9'}")
    assert ended.code == 2
    assert "seed" in ended.message
    assert "too many digits" in ended.message


@pytest.mark.parametrize(
    ("line", "shown"),
    [
        ("plan rest.toml --out a\0b.npz", r"a\x00b.npz"),
        ("info a\vb.mcap", r"a\x0bb.mcap"),
        ("recover cut.mcap.partial --out a\u202eb.mcap", r"a\u202eb.mcap"),
        ("run a\udcff.toml", r"a\xff.toml"),
        ("demo --folder a\udcffü", r"a\xffü"),
        ("report -- \udcff", r"\xff"),
    ],
)
def test_a_name_that_is_not_one_line_of_text_is_refused(line: str, shown: str) -> None:
    """Logs and tables cannot hold such names, and a message cannot show them."""
    ended = dpcontrol(*line.split(" "))
    assert ended.code == 2
    wanted = f"dpcontrol: {shown}: must be one line of UTF-8 without control characters; rename it or use another name"
    assert ended.stderr.splitlines() == [wanted]
    assert dpcontrol("info", "a\nb.mcap").stderr == wanted.replace(shown, r"a\nb.mcap") + "\n"


@pytest.mark.parametrize("verb", ["replay", "identify"])
def test_samples_that_contradict_the_nominal_period_are_refused(verb: str) -> None:
    """Such stretches were once split into the number of pieces of years."""
    _recorded(Path("slow.mcap"), period=1e-3, stamps=1e5)
    ended = dpcontrol(verb, "slow.mcap", "--out", "out.toml" if verb == "identify" else "out.mcap")
    assert ended.code == 2
    assert "their nominal period is" in ended.message


def test_a_recording_too_slow_for_swings_is_not_identified() -> None:
    _recorded(Path("slow.mcap"), period=100.0, stamps=100.0)
    ended = dpcontrol("identify", "slow.mcap", "--out", "out.toml")
    assert ended.code == 2
    assert "record faster" in ended.message


def _recorded(path: Path, *, period: float, stamps: float) -> None:
    """Write a log of 40 samples with an interval of `stamps` s and a nominal period."""
    with LogWriter(path, arm_lengths=(0.17, 0.23), rate_hz=1 / period, has_cart=False) as log:
        log.ticks(stamps * np.arange(40), measured=np.sin(np.arange(80.0)).reshape(40, 2))


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("connection_0_times", np.zeros(3)),
        ("connection_0_states", np.zeros(4)),
        ("cut_0_strand_phases", np.zeros((2, 2))),
        ("orbit_0_samples", np.zeros((0, 4))),
    ],
)
def test_an_atlas_with_inconsistent_arrays_is_refused(name: str, value: np.ndarray) -> None:
    assert dpcontrol("atlas", "lab", "--energy=-0.07", "--out", "atlas.npz").code == 0
    with np.load("atlas.npz") as file:
        arrays = dict(file)
    np.savez("other.npz", **{**arrays, name: value})
    ended = dpcontrol("review", "other.npz", "--save", "out.rrd")
    assert ended.code == 2
    assert name in ended.message
    assert not Path("out.rrd").exists()


@pytest.mark.parametrize(
    ("key", "value"), [("energy", "high"), ("connections", [1]), ("complete", 7), ("status", None)]
)
def test_an_atlas_with_header_values_of_wrong_types_is_refused(key: str, value: object) -> None:
    assert dpcontrol("atlas", "lab", "--energy=-0.07", "--out", "atlas.npz").code == 0
    with np.load("atlas.npz") as file:
        arrays = dict(file)
    header = json.loads(str(arrays["header"]))
    place = header["kinds"][0] if key == "complete" else header
    place[key] = value
    np.savez("other.npz", **{**arrays, "header": np.array(json.dumps(header))})
    assert dpcontrol("review", "other.npz", "--save", "out.rrd").code == 2


@pytest.mark.parametrize("key", ["cut_0_piece_0_points", "energy"])
def test_an_atlas_with_a_number_beyond_all_results_is_refused(key: str) -> None:
    assert dpcontrol("atlas", "lab", "--energy=-0.07", "--out", "atlas.npz").code == 0
    with np.load("atlas.npz") as file:
        arrays = dict(file)
    if key in arrays:
        arrays[key][::2, 1] = 1e307
    else:
        header = json.loads(str(arrays["header"]))
        arrays["header"] = np.array(json.dumps({**header, key: 1e307}))
    np.savez("other.npz", **arrays)
    ended = dpcontrol("review", "other.npz", "--save", "out.rrd")
    assert ended.code == 2
    assert "1e+307, and no result exceeds 1e+100" in ended.message
    assert not Path("out.rrd").exists()


def test_a_log_without_a_list_of_attachments_is_not_recovered(monkeypatch: pytest.MonkeyPatch) -> None:
    with monkeypatch.context() as patch:
        patch.setattr("dpcontrol.logs.writer.json", SimpleNamespace(dumps=lambda names: "7"))
        _recorded(Path("odd.mcap"), period=1e-3, stamps=1e-3)
    whole = Path("odd.mcap").read_bytes()
    Path("odd.mcap").write_bytes(whole[:-40])
    ended = dpcontrol("recover", "odd.mcap", "--out", "new.mcap")
    assert ended.code == 2
    assert "attachments" in ended.message


@pytest.mark.parametrize("name", ["", "."])
def test_an_output_without_a_name_is_refused(name: str) -> None:
    ended = dpcontrol("import", "--simulated", "lab", f"--out={name}")
    assert ended.code == 2
    assert "--out" in ended.message


def test_control_characters_in_a_title_are_drawn_as_text(recwarn: pytest.WarningsRecorder) -> None:
    figure = new_figure(3, 2)
    figure.suptitle("\x1b[31mred")
    save_figure(figure, Path("out.png"))
    assert not [str(one.message) for one in recwarn if "\x1b" in str(one.message) or "Glyph" in str(one.message)]


def test_control_characters_in_a_title_are_drawn_as_text_on_a_page(recwarn: pytest.WarningsRecorder) -> None:
    """The page was drawn once for its layout before the characters were written out."""
    page = Page("a\x1b[31m\x07 title", "verdict").text("a $ and \x1b").figure()
    save_figure(page, "page.png")
    assert not recwarn.list


def test_characters_that_no_font_has_are_drawn_without_warnings(recwarn: pytest.WarningsRecorder) -> None:
    save_figure(Page("\U0001f680 \ue000", "verdict").figure(), "page.png")
    assert not recwarn.list


def test_a_huge_integer_is_refused_before_use() -> None:
    line = "bifurcations lab --from down-up --to down-up --energies -0.3 -0.2"
    ended = dpcontrol(*line.split(), f"--samples={400 * '9'}")
    assert ended.code == 2
    assert "--samples" in ended.message


def test_a_report_on_a_file_without_a_name_is_refused() -> None:
    assert dpcontrol("report", "").code == 2


def test_a_log_of_arms_without_length_is_refused() -> None:
    with LogWriter("flat.mcap", arm_lengths=(0.0, 0.0), rate_hz=1e3, has_cart=False) as log:
        log.ticks(1e-3 * np.arange(40), measured=np.zeros((40, 2)))
    ended = dpcontrol("report", "flat.mcap")
    assert ended.code == 2
    assert "long" in ended.message


def test_angles_beyond_the_range_of_swings_are_not_identified() -> None:
    with LogWriter("far.mcap", arm_lengths=(0.17, 0.23), rate_hz=1e3, has_cart=False) as log:
        log.ticks(1e-3 * np.arange(400), measured=1e300 * np.sin(np.arange(800.0)).reshape(400, 2))
    ended = dpcontrol("identify", "far.mcap")
    assert ended.code == 2
    assert "not plausible" in ended.message


def test_swings_with_a_negative_seed_are_refused() -> None:
    ended = dpcontrol("import", "--simulated", "lab", "--seed=-1")
    assert ended.code == 2
    assert "seed = -1" in ended.message


@pytest.mark.parametrize(("key", "value"), [("seed", "\x1b[31m"), ("real_time_factor", "fast")])
def test_a_log_with_invalid_notes_is_not_scored(key: str, value: str) -> None:
    assert dpcontrol("run", "rest.toml", "--out", "run.mcap").code == 0
    log = read_log("run.mcap")
    score(log)
    log.metadata[key] = value
    with pytest.raises(InputError, match=f"its {key} = "):
        score(log)


def test_a_run_that_fails_before_its_first_tick_removes_its_new_folder() -> None:
    def failing(folder: str) -> None:
        with LogWriter(f"{folder}/run.mcap", arm_lengths=(0.2, 0.2), rate_hz=1e3, has_cart=False):
            raise InputError("no reading came")

    Path("there").mkdir()
    for folder in ("made", "there"):
        with pytest.raises(InputError):
            failing(folder)
    assert not Path("made").exists()
    assert not list(Path("there").iterdir())


def test_an_estimator_with_huge_assumptions_is_refused() -> None:
    assert dpcontrol("run", "rest.toml", "--out", "run.mcap").code == 0
    ended = dpcontrol("replay", "run.mcap", "--model-error=1e300")
    assert ended.code == 2
    assert "--model-error" in ended.message
    with pytest.raises(InputError, match=r"parameter_error = 1e.300: must be"):
        filter_settings("ekf", model_error=1e300)


@pytest.mark.parametrize("picture", [f"{255 * 'e'}.png", "rest.toml/a.png"])
def test_a_picture_that_cannot_be_written_is_refused_before_the_model(picture: str) -> None:
    ended = dpcontrol("identify", "run.mcap", "--picture", picture)
    assert ended.code == 2
    assert f"cannot use {picture}" in ended.message


@pytest.mark.parametrize(("part", "value"), [("mesh", np.inf), ("inputs", 1e99), ("states", np.nan)])
def test_a_reference_with_huge_values_is_refused_without_a_warning(part: str, value: float) -> None:
    assert dpcontrol("plan", "rest.toml", "--out", "reference.npz").code == 0
    reference = load_reference(Path("reference.npz"))
    changed = getattr(reference, part).copy()
    changed[-1] = value
    save_reference(Path("far.npz"), replace(reference, **{part: changed}))
    ended = dpcontrol("reference", "far.npz")
    assert ended.code == 2
    assert "or too large" in ended.message
    assert "Warning" not in ended.message


def test_a_reference_with_a_mesh_of_infinities_is_refused_without_a_warning() -> None:
    """NumPy warned of the difference of two infinities."""
    assert dpcontrol("plan", "rest.toml", "--out", "reference.npz").code == 0
    reference = load_reference(Path("reference.npz"))
    save_reference(Path("far.npz"), replace(reference, mesh=np.full_like(reference.mesh, np.inf)))
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        with pytest.raises(InputError, match="its mesh does not rise"):
            load_reference(Path("far.npz"))


@pytest.mark.parametrize("option", ["", "--debug"])
def test_numpys_warnings_are_printed_for_debugging_only(option: str) -> None:
    """The difference of two huge angles overflows."""
    rows = [f"{k / 100},{angle},0.1" for k, angle in enumerate([0.1] * 30 + ["1e308", "-1e308"] + [0.1] * 30)]
    Path("jump.csv").write_text("\n".join(["time,angle_1,angle_2", *rows]))
    ended = dpcontrol_program("import", "jump.csv", *option.split(), folder=Path())
    assert ended.code == 2
    assert ("RuntimeWarning" in ended.stderr) == bool(option)


def test_a_reference_with_absurd_rates_is_shown_after_a_limited_number_of_steps() -> None:
    """Its arms turn 10⁸ times in a second, which took minutes to propagate."""
    assert dpcontrol("plan", "rest.toml", "--out", "reference.npz").code == 0
    reference = load_reference(Path("reference.npz"))
    save_reference(Path("fast.npz"), replace(reference, states=np.full_like(reference.states, 1e9)))
    assert "inf measured again" in dpcontrol("reference", "fast.npz").stdout


def test_warnings_of_a_users_law_are_printed() -> None:
    law = "import warnings\nclass Law:\n    def control(self, time, state, reference):\n"
    Path("law.py").write_text(law + "        warnings.warn('gain is high')\n        return 0.0\n")
    ended = dpcontrol_program("run", "rest.toml", "--controller", "law.py:Law", folder=Path())
    assert "UserWarning: gain is high" in ended.stderr


@pytest.mark.parametrize("kind", ["datetime64[s]", "complex128", "V8"])
def test_an_archive_of_other_values_than_numbers_is_refused(kind: str) -> None:
    """Dates in the place of an atlas's times ended in a traceback."""
    assert dpcontrol("plan", "rest.toml", "--out", "reference.npz").code == 0
    reference = load_reference(Path("reference.npz"))
    save_reference(Path("odd.npz"), replace(reference, extra={"times": np.zeros(3, dtype=kind)}))
    with pytest.raises(InputError, match="instead of numbers"):
        load_reference(Path("odd.npz"))


def test_a_segment_of_one_sample_of_a_moving_cart_is_written() -> None:
    """Its velocity was differentiated."""
    zeros, times = np.zeros(4), np.array([0.0, 0.01, 0.02, 9.0])
    recording = Recording(
        "swing", "swing.csv", 0.01, times, zeros[:, None], zeros[:, None], ((0, 3), (3, 4)), (0.2,), cart=times
    )
    write_samples(recording, Path("swing.mcap"), "import", [(0, 3, "info", ""), (3, 4, "info", "")], metadata={})
    velocity = read_log(Path("swing.mcap")).rates
    assert velocity is not None
    assert velocity[:, 1] == pytest.approx([1.0, 1.0, 1.0, 0.0])


@pytest.mark.parametrize(
    ("value", "reason"),
    [
        ("small", "its max_error_between_nodes is not a number"),
        ([1e-9], "its max_error_between_nodes is not a number"),
        (10**400, "no result exceeds 1e+100"),
    ],
    ids=["text", "list", "huge"],
)
def test_a_reference_with_invalid_figures_is_refused(value: object, reason: str) -> None:
    assert dpcontrol("plan", "rest.toml", "--out", "reference.npz").code == 0
    reference = load_reference(Path("reference.npz"))
    save_reference(Path("odd.npz"), replace(reference, max_error_between_nodes=value))
    for call in ("reference odd.npz", "review odd.npz --save new.rrd"):
        ended = dpcontrol(*call.split())
        assert ended.code == 2
        assert reason in ended.message


def test_a_reference_with_invalid_limits_is_refused() -> None:
    assert dpcontrol("plan", "rest.toml", "--out", "reference.npz").code == 0
    with np.load("reference.npz") as archive:
        parts = dict(archive)
    header = json.loads(str(parts["header"]))
    header["limits"]["position"] = [0.4]
    np.savez("odd.npz", **{**parts, "header": np.array(json.dumps(header))})
    for call in ("reference odd.npz", "review odd.npz --save new.rrd"):
        ended = dpcontrol(*call.split())
        assert ended.code == 2
        assert "its limits are not numbers" in ended.message


def test_a_log_with_extremely_slow_samples_is_refused() -> None:
    with LogWriter("slow.mcap", arm_lengths=(0.2, 0.2), rate_hz=1e-9, has_cart=False) as log:
        log.ticks(np.zeros(1), measured=np.zeros((1, 2)))
    for verb in ("info", "replay", "recover"):
        ended = dpcontrol(verb, "slow.mcap")
        assert ended.code == 2
        assert "the tick rate in its layout is 1e-09 Hz" in ended.message


def test_a_refused_picture_of_transitions_leaves_no_other_picture() -> None:
    assert dpcontrol("plan", "rest.toml", "--out", "reference.npz").code == 0
    ended = dpcontrol("reference", "reference.npz", "--picture", "new.png", "--transitions", "square.png")
    assert ended.code == 2
    assert "has no transfers" in ended.message
    assert not list(Path().glob("*.png"))
    ended = dpcontrol("reference", "reference.npz", "--picture", "new.png", "--transitions", "./new.png")
    assert ended.code == 2
    assert "--picture and --transitions both name new.png" in ended.message


@pytest.mark.skipif(not Path("/proc/self/mem").exists(), reason="/proc is Linux's")
def test_an_unreadable_library_is_refused() -> None:
    ended = dpcontrol("run", "rest.toml", "--controller-library", "/proc/self/mem")
    assert ended.code == 2
    assert "cannot use a file: Input/output error" in ended.message


def test_a_log_of_fewer_ticks_than_a_mean_of_the_drives_error_is_shown() -> None:
    assert dpcontrol("run", "rest.toml", "--out", "run.mcap").code == 0
    log = read_log(Path("run.mcap"))
    view = run_view(log)
    assert view.control is not None
    assert log.extras is not None
    few = replace(view, control={name: column[:3] for name, column in view.control.items()})
    assert set(true_extras(replace(log, time=log.time[:3]), few)) <= set(log.extras.names)


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="/dev/full is Linux's")
@pytest.mark.parametrize("unbuffered", ["", "1"])
@pytest.mark.parametrize(
    ("call", "code", "said"),
    [
        ("model none --json", 2, "there is no model named 'none'"),
        ("model lab --json", 1, "no space left on standard output"),
        ("model lab", 1, "no space left on standard output"),
    ],
)
def test_a_full_output_gives_one_sentence_and_the_exit_code(call: str, code: int, said: str, unbuffered: str) -> None:
    with open("/dev/full", "w") as full:
        done = subprocess.run(
            [PROGRAM, *call.split()], stdout=full, stderr=subprocess.PIPE, text=True, check=False,
            env={**os.environ, "PYTHONUNBUFFERED": unbuffered},
        )  # fmt: skip
    assert done.returncode == code
    assert done.stderr.startswith(f"dpcontrol: {said}")
    assert done.stderr.count("\n") == 1


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="/dev/full is Linux's")
@pytest.mark.parametrize(("call", "code"), [("run rest.toml --json", 0), ("score none.mcap --json", 2)])
def test_a_full_stderr_changes_neither_the_answer_nor_the_exit_code(call: str, code: int) -> None:
    with open("/dev/full", "w") as full:
        done = subprocess.run([PROGRAM, *call.split()], stdout=subprocess.PIPE, stderr=full, text=True, check=False)
    assert done.returncode == code
    assert json.loads(done.stdout).get("completed") is (True if code == 0 else None)


@pytest.mark.parametrize(
    ("keys", "said"),
    [
        ("[controller]\nkind = []", "[controller] kind = []: "),
        ("[estimator]\nkind = {}", "[estimator] kind = {}: "),
        ("[run]\nblows = nan", "[run] blows = nan: must be a list of tables, [[run.blows]]"),
        ("[run]\nblows = [[]]", "[run] blows = [[]]: must be a list of tables, [[run.blows]]"),
    ],
)
def test_a_value_of_another_type_where_a_kind_or_tables_belong_is_refused(keys: str, said: str) -> None:
    Path("rest.toml").write_text(REST.partition("[controller]")[0] + keys + "\n")
    ended = dpcontrol("run", "rest.toml")
    assert ended.code == 2
    assert said in ended.message


def test_a_rate_of_1e300_in_a_recording_is_refused_in_one_sentence(recwarn: pytest.WarningsRecorder) -> None:
    time = np.arange(300) * 1e-3
    columns = [time, 0.3 * np.cos(time), 0.2 * np.cos(time), -0.3 * np.sin(time), np.full(300, 1e300)]
    rows = [",".join(f"{value:.9g}" for value in row) for row in zip(*columns, strict=True)]
    Path("swing.csv").write_text("\n".join(["time,angle_1,angle_2,rate_1,rate_2", *rows]))
    ended = dpcontrol("import", "swing.csv")
    assert ended.code == 2
    assert "rate 2 is 1e+300, which no bench reaches in any unit" in ended.message
    assert not recwarn.list


def test_a_repetition_of_a_log_without_comparable_messages_writes_nothing() -> None:
    """The run used to be repeated first."""
    assert dpcontrol("run", "rest.toml", "--out", "rest.mcap").code == 0
    with Path("rest.mcap").open("rb") as file, Path("other.mcap").open("wb") as copy:
        _copied(make_reader(file), Writer(copy), left_out="dpcontrol.layout")
    ended = dpcontrol("run", "--from", "other.mcap")
    assert ended.code == 2
    assert "it lacks the metadata record dpcontrol.layout" in ended.message
    assert {path.name for path in Path().iterdir()} == {"rest.toml", "rest.mcap", "other.mcap"}


def test_a_log_whose_schema_rerun_rejects_is_recorded_from_its_values() -> None:
    """This ended in a traceback."""
    assert dpcontrol("run", "rest.toml", "--out", "rest.mcap").code == 0
    with Path("rest.mcap").open("rb") as file, Path("other.mcap").open("wb") as copy:
        _copied(make_reader(file), Writer(copy), {"tf2_msgs/msg/TFMessage": b"ge"})
    ended = dpcontrol("review", "other.mcap", "--save", "other.rrd")
    assert ended.code == 0, ended.stderr
    assert Path("other.rrd").stat().st_size > 10_000


def test_a_rewritten_log_with_a_damaged_message_is_recorded_from_its_values() -> None:
    """Rerun's reader aborted the process."""
    assert dpcontrol("run", "rest.toml", "--out", "rest.mcap").code == 0
    with Path("rest.mcap").open("rb") as file, Path("other.mcap").open("wb") as copy:
        _copied(make_reader(file), Writer(copy), damaged="/tf")
    ended = dpcontrol_program("review", "other.mcap", "--save", "other.rrd", folder=Path())
    assert ended.code == 0, ended.stderr
    assert Path("other.rrd").stat().st_size > 10_000


_FRAME = b"\x06\0\0\0world\0"


def test_a_rewritten_log_with_a_damaged_itinerary_is_refused() -> None:
    """Its text ended in a traceback."""
    assert dpcontrol("run", "rest.toml", "--out", "rest.mcap").code == 0
    with Path("rest.mcap").open("rb") as file, Path("other.mcap").open("wb") as copy:
        _copied(make_reader(file), Writer(copy), damaged="scene.toml")
    ended = dpcontrol("report", "other.mcap", "--margins")
    assert ended.code == 2
    assert "its model or itinerary is damaged" in ended.message


def test_a_rewritten_log_with_an_event_in_600_years_is_refused() -> None:
    """Rerun's conversion to nanoseconds ended in a traceback."""
    assert dpcontrol("run", "rest.toml", "--out", "rest.mcap").code == 0
    with Path("rest.mcap").open("rb") as file, Path("other.mcap").open("wb") as copy:
        _copied(make_reader(file), Writer(copy), late="/rosout")
    ended = dpcontrol("review", "other.mcap", "--save", "other.rrd")
    assert ended.code == 2
    assert "damaged (an event is at 1.84e+10 s)" in ended.message
    assert not Path("other.rrd").exists()


def test_a_log_without_the_notes_of_its_plan_is_not_repeated(monkeypatch: pytest.MonkeyPatch) -> None:
    """It was refused only after the run, which left its log."""
    assert dpcontrol("run", "rest.toml", "--out", "rest.mcap").code == 0
    log = read_log(Path("rest.mcap"))
    reference = load_reference(BytesIO(log.attachments["reference.npz"]))
    save_reference(Path("bare.npz"), replace(reference, notes={"title": "bare"}))
    bare = {**log.attachments, "reference.npz": Path("bare.npz").read_bytes()}
    monkeypatch.setattr("dpcontrol.runs.run.read_log", lambda path: replace(log, attachments=bare))
    ended = dpcontrol("run", "--from", "rest.mcap", "--out", "again.mcap")
    assert ended.code == 2
    assert "holds no plan" in ended.message
    assert not Path("again.mcap").exists()


def test_a_log_with_deeply_nested_metadata_is_shown_without_its_model() -> None:
    """Python's JSON reader exceeded its recursion limit."""
    assert dpcontrol("run", "rest.toml", "--out", "rest.mcap").code == 0
    log = read_log(Path("rest.mcap"))
    nested = dict.fromkeys(("model_parameters", "plant_parameters", "drawn"), "[" * 5000)
    view = run_view(replace(log, metadata={**log.metadata, **nested}))
    assert len(view.time) == len(log.time)


def _copied(
    reader: McapReader,
    writer: Writer,
    schemas: Mapping[str, bytes] = MappingProxyType({}),
    *,
    damaged: str = "",
    late: str = "",
    left_out: str = "",
) -> None:
    """Copy a log as another program does: with its own numbers of schemas and channels, and the given schemas.

    In a message of the topic `damaged`, the length of the frame's name exceeds the message. An attachment of that name
    begins with a byte that is no text. Messages of the topic `late` are logged at the end of time. The metadata record
    `left_out` is not copied.
    """
    writer.start()
    channels: dict[int, int] = {}
    for schema, channel, message in reader.iter_messages():
        if channel.id not in channels:
            number = (
                0
                if schema is None
                else writer.register_schema(schema.name, schema.encoding, schemas.get(schema.name, schema.data))
            )
            channels[channel.id] = writer.register_channel(
                channel.topic, channel.message_encoding, number, channel.metadata
            )
        data = message.data
        if channel.topic == damaged and message.log_time:
            before, _, after = data.rpartition(_FRAME)
            data, damaged = before + b"\xff\xff" + _FRAME[2:] + after, ""
        time = 2**64 - 1 if channel.topic == late else message.log_time
        writer.add_message(channels[channel.id], time, data, message.publish_time, message.sequence)
    for record in (one for one in reader.iter_metadata() if one.name != left_out):
        writer.add_metadata(record.name, record.metadata)
    for attached in reader.iter_attachments():
        data = b"\xff" + attached.data if attached.name == damaged else attached.data
        writer.add_attachment(attached.create_time, attached.log_time, attached.name, attached.media_type, data)
    writer.finish()
