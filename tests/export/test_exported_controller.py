"""Exported C99 compared with the loop's tick, by gcc and clang: equal commands and decisions."""

import ctypes
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from c_compilers import REPLAY, SOURCES, SideBySide, compiled, library, needed, ran
from library_program import LibraryProgram

from dpcontrol.control.tick import SETTLING
from dpcontrol.control.tick_parts import Outcome
from dpcontrol.loop.assembly import Assembly
from dpcontrol.loop.simulated import SimulatedRig
from dpcontrol.plans.plan import Plan

# Seconds for generation and compilation of C.
pytestmark = pytest.mark.slow

SAME = 1e-9  # m/s²: rounding of sines times the law's gains, and interpolation of the tables.
RUNNING, FINISHED, BRAKING, AT_REST = range(4)


def readings(folder: Path) -> np.ndarray:
    return np.genfromtxt(folder / "readings.csv", delimiter=",", skip_header=1)


def set_clock(program: LibraryProgram, tick: int) -> None:
    """Set the count of completed steps, the last field of dpc_controller."""
    place = program.described.controller_bytes - ctypes.sizeof(ctypes.c_long)
    ctypes.c_long.from_address(program.controller_address + place).value = tick


def test_nothing_is_allocated_and_no_other_name_is_taken(double: Path) -> None:
    # Data that are relocated on loading would look like a variable.
    options = ["-O0", "-fno-pic", "-fno-pie", "-c"]
    made = compiled("gcc", *options, folder=double, out="controller.o", sources=SOURCES[:1])
    symbols = [line.split()[-2:] for line in ran(needed("nm"), made, folder=double).stdout.splitlines()]
    assert {name for kind, name in symbols if kind == "T"} == {
        "dpc_init", "dpc_step", "dpc_sent", "dpc_status", "dpc_queued", "dpc_reference", "dpc_describe"
    }  # fmt: skip
    assert not [name for kind, name in symbols if kind in "BbDdCG"], "a variable outlives a call"
    asked = {name for kind, name in symbols if kind == "U"} - {"memcpy", "memmove", "memset"}
    functions = {name.removesuffix("f") for name in asked if not name.startswith(("dpc_", "_"))}
    assert functions <= {"sin", "cos", "sqrt", "atan2", "fabs", "exp", "pow"}


def test_a_replayed_run_gets_the_loops_commands(double: Path) -> None:
    folder = double
    program = compiled("gcc", "-O1", folder=folder, out="replay", sources=REPLAY)
    done = ran(program, "readings.csv", folder=folder)
    assert done.returncode == 0, done.stderr
    rows = np.genfromtxt(done.stdout.splitlines(), delimiter=",", skip_header=1)
    given = readings(double)
    assert len(rows) == len(given) > 3000
    assert np.abs(rows[:, 2] - given[:, -1]).max() <= SAME
    assert not rows[:-1, 3:].any()
    assert rows[-1, 3:].tolist() == [Outcome.GO_ON, FINISHED]
    # The same readings as binary numbers of this machine.
    binary = np.insert(given, 3, 0.0, axis=1)
    binary.astype("<f8").tofile(folder / "readings.bin")
    assert ran(program, "readings.bin", folder=folder).stdout == done.stdout
    # A wrong command is detected, and a file with another layout is refused.
    text = (folder / "readings.csv").read_text().splitlines()
    (folder / "wrong.csv").write_text("\n".join([*text[:50], text[50].rsplit(",", 1)[0] + ",1", *text[51:60]]))
    assert ran(program, "wrong.csv", folder=folder).returncode == 1
    (folder / "other.csv").write_text("time,angle\n0,1\n")
    assert ran(program, "other.csv", folder=folder).returncode == 2


def test_a_law_with_a_known_lag_is_exported_with_it(exported_law: Callable[..., Path]) -> None:
    folder = exported_law("outer-turn", "adaptive", "double", lag=0.02, drive_lag=0.02)
    assert "gains 6, drive 1, drive_gain 1" in (folder / "dpc_tables.h").read_text()
    program = compiled("gcc", "-O0", folder=folder, out="replay", sources=REPLAY)
    done = ran(program, "readings.csv", folder=folder)
    assert done.returncode == 0, done.stderr
    assert "4877 ticks, commands differ by" in done.stderr


def test_an_export_ignores_the_angle_of_an_arm_without_an_encoder(exported_law: Callable[..., Path]) -> None:
    folder = exported_law("outer-turn", "adaptive", "double", encoders=(True, False))
    program = compiled("gcc", "-O0", folder=folder, out="replay", sources=REPLAY)
    head, *rows = (line.split(",") for line in (folder / "readings.csv").read_text().splitlines())
    assert {row[1] for row in rows} == {"nan"}
    (folder / "nonsense.csv").write_text(
        "\n".join(",".join(row) for row in [head, *([a, "7", *b] for a, _, *b in rows)])
    )
    done = [ran(program, name, folder=folder) for name in ("readings.csv", "nonsense.csv")]
    assert [one.returncode for one in done] == [0, 0], done[0].stderr
    assert done[0].stdout == done[1].stdout


def test_every_number_of_the_report_is_the_loops(plan: Plan, double: Path) -> None:
    both, rows = SideBySide(plan, library(double)), readings(double)[:300, :3]
    for k, positions in enumerate(rows):
        present = None
        if 100 <= k < 120:
            # Missing measurements may have any value.
            present, positions = np.array([True, False, k % 2 == 0]), np.array([positions[0], np.nan, positions[2]])
        own, other = both(positions, present=present)
        for name in own:
            assert other[name] == pytest.approx(own[name], rel=1e-6, abs=1e-8), (k, name)
    assert both.c.status == RUNNING


@pytest.mark.parametrize("sensor", [2, 3])
def test_a_stuck_sensor_brakes_the_cart_at_the_same_tick(plan: Plan, double: Path, sensor: int) -> None:
    loop = plan.itinerary.with_run({"stuck_at": 0.9, "stuck_sensor": sensor - 1}).loop
    both, assembly = SideBySide(plan, library(double)), Assembly(plan.reference, plan.itinerary.model.arms, loop)
    start, queued = assembly.controller.first_state, both.own.queued[:, 0].tolist()
    rig, outcomes = SimulatedRig(assembly.draw(), loop.bench, limits=assembly.limits, start=start, queued=queued), []
    for _ in range(1400):
        own, other = both(rig.read().positions)
        rig.command(float(own["command"][0]))
        outcomes.append((own["outcome"][0], other["outcome"][0], other["sensor"][0]))
    decided = [(own, other, which) for own, other, which in outcomes if own or other]
    assert decided == [(Outcome.STUCK, Outcome.STUCK, sensor)]


@pytest.mark.parametrize(
    ("trouble", "outcome"),
    [("switch", Outcome.SWITCH), ("silence", Outcome.SILENT), ("far", Outcome.CART), ("nan", Outcome.SILENT)],
)
def test_decisions_of_the_supervisor_bring_the_cart_to_rest(
    plan: Plan, double: Path, trouble: str, outcome: Outcome
) -> None:
    both, rows = SideBySide(plan, library(double), told=False), readings(double)[:, :3].copy()
    told = []
    for k, positions in enumerate(rows[:1000]):
        on, present = k >= 300, None
        if on and trouble == "silence":
            present = np.zeros(3, dtype=bool)
        if on and trouble == "far":
            positions = np.add(positions, [0, 0, 0.6])
        if on and trouble == "nan":
            positions = positions * np.nan
        own, other = both(positions, present=present, switch=int(on and trouble == "switch"))
        if other["outcome"][0] >= Outcome.ESTIMATE_LOST:
            assert other["outcome"][0] == own["outcome"][0]
            # A jump of the cart's position changes the estimate of the arms.
            assert other["outcome"][0] in ((outcome, Outcome.FALLEN) if trouble == "far" else (outcome,))
            assert both.c.status == BRAKING
        told.append(other)
        if other["done"][0]:
            break
    assert both.c.status == AT_REST
    stopped = next(k for k, report in enumerate(told) if report["stop"][0])
    most = plan.reference.limits.acceleration
    assert all(abs(report["command"][0]) <= most for report in told)
    # After the cart has stopped, there are no commands.
    still = round(SETTLING * 1000) - 1
    assert all(report["command"][0] == 0.0 for report in told[-still:])
    assert stopped < len(told) - still


def test_after_the_last_tick_the_last_row_keeps_holding(plan: Plan, double: Path) -> None:
    both = SideBySide(plan, library(double), told=False)
    rows = Assembly(plan.reference, plan.itinerary.model.arms, plan.itinerary.loop).controller.schedule(1).rows
    # Its clock is set to just before the end, so only the rows decide.
    set_clock(both.c, both.count - 3)
    told, states = [], []
    for _ in range(8):
        told.append(both(both.references[0][[0, 1, 4]])[1]["feedforward"][0])
        states.append(both.c.status)
    assert told == pytest.approx([*rows[-3:, 0], *[rows[-1, 0]] * 5], abs=SAME)
    assert states == [RUNNING] * 2 + [FINISHED] * 6


def test_the_header_gives_the_first_commands_and_the_reference(plan: Plan, double: Path) -> None:
    both = SideBySide(plan, library(double))
    c = ctypes.CDLL(str(library(double)))
    c.dpc_queued.restype = ctypes.c_double
    c.dpc_queued.argtypes = [ctypes.c_long]
    assert [c.dpc_queued(k) for k in (-1, 0, 1)] == [0.0, both.own.queued[0, 0], 0.0]
    state = (ctypes.c_double * 6)()
    for tick, row in ((-5, 0), (0, 0), (1234, 1234), (10**9, -1)):
        c.dpc_reference(ctypes.c_long(tick), state)
        assert np.array(state) == pytest.approx(both.references[row], abs=SAME)
