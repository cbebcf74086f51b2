"""The co-simulation unit, which conforms to the standard and equals the exported C to the last bit."""

import shutil
import subprocess
import zipfile
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pytest
from library_program import library_ticker
from shadowing_stand_in import LAB

from dpcontrol.control.export import ControllerSource, Unit, controller_source, controller_unit
from dpcontrol.control.interface import sampled_model
from dpcontrol.control.tracking import TrackingController, tracking_controller
from dpcontrol.loop.assembly import Assembly
from dpcontrol.loop.loop import LoopSettings
from dpcontrol.loop.simulated import SimulatedRig
from dpcontrol.references.reference import Reference

NEEDED = "needs FMPy, which imports the unit: pip install 'dpcontrol[fmu]'"
fmpy = pytest.importorskip("fmpy", reason=NEEDED)
validation = pytest.importorskip("fmpy.validation", reason=NEEDED)
if shutil.which("gcc") is None:
    pytest.skip("needs gcc", allow_module_level=True)

# A unit includes a binary, for which gcc takes seconds.
pytestmark = pytest.mark.slow

TICKS = 600
SETTINGS = LoopSettings(seed=3, mismatch=0.02, initial_error=0.02)
JOINTS = ("arm_1", "arm_2", "cart")
STATES = ("angle_1", "angle_2", "rate_1", "rate_2", "cart_position", "cart_velocity")
SCALARS = (
    "command", "wish", "feedforward", "feedback", "acting", "nis", "mean_nis", "error", "silent", "outcome",
    "stopped_by", "mode", "used", "refused", "sensor", "repeats", "untrusted", "stop", "done", "saturated", "newly_cut",
)  # fmt: skip
VECTORS = {"state": "", "reference": "reference_", "ahead": "ahead_", "sigmas": "sigma_"}
PERIOD = 1 / SETTINGS.rate


class Exported(NamedTuple):
    controller: TrackingController
    reference: Reference
    source: ControllerSource
    library: Path
    unit: Path
    made: Unit


@pytest.fixture(scope="module")
def exported(reference: Reference, tmp_path_factory: pytest.TempPathFactory) -> Exported:
    """The beginning of the turn."""
    whole = tracking_controller(reference, sampled_model(LAB, SETTINGS.rate), SETTINGS.controller)
    short = replace(
        whole, reference_states=whole.reference_states[: TICKS + 1], feedforward=whole.feedforward[:TICKS],
        gains=whole.gains[:TICKS],
    )  # fmt: skip
    ticker = Assembly(reference, LAB, SETTINGS, law=short).ticker()
    source = controller_source(ticker.program, short, itinerary="turn", title="A turn", single=False, readings="")
    made = controller_unit(source, ticker.program, short, name="2-turn", title="A turn", delay=1.0)
    folder = tmp_path_factory.mktemp("exported")
    for name, text in source.files.items():
        (folder / name).write_text(text)
    flags = ["-std=c99", "-O2", "-ffp-contract=off", "-fPIC", "-shared"]
    subprocess.run(
        ["gcc", *flags, "-o", "libdpc.so", "dpc_controller.c", "dpc_tables.c", "-lm"], cwd=folder, check=True
    )
    (folder / "2-turn.fmu").write_bytes(made.archive)
    return Exported(short, reference, source, folder / "libdpc.so", folder / "2-turn.fmu", made)


class Slave:
    """An instance of the unit with variables by name."""

    def __init__(self, exported: Exported, folder: Path, *, start: float = 0.0) -> None:
        self.described = fmpy.read_model_description(str(exported.unit), validate=True)
        self.variables = {one.name: one for one in self.described.modelVariables}
        fmpy.extract(str(exported.unit), str(folder))
        self.said: list[str] = []
        self.fmu = fmpy.fmi2.FMU2Slave(
            guid=self.described.guid, unzipDirectory=str(folder), instanceName="one",
            modelIdentifier=self.described.coSimulation.modelIdentifier,
        )  # fmt: skip
        self.fmu.instantiate()
        self.fmu.setupExperiment(startTime=start)
        self.fmu.enterInitializationMode()
        self.fmu.exitInitializationMode()

    def set(self, name: str, value: Any) -> None:
        one = self.variables[name]
        getattr(self.fmu, f"set{one.type}")([one.valueReference], [value])

    def get(self, name: str) -> Any:
        one = self.variables[name]
        return getattr(self.fmu, f"get{one.type}")([one.valueReference])[0]

    def all(self, prefix: str, names: Sequence[str]) -> list[float]:
        return [self.get(f"{prefix}{name}") for name in names]

    def step(self, begin: float, size: float = PERIOD) -> None:
        self.fmu.doStep(currentCommunicationPoint=begin, communicationStepSize=size)


@contextmanager
def running(exported: Exported, folder: Path, **settings: Any) -> Iterator[Slave]:
    slave = Slave(exported, folder, **settings)
    try:
        yield slave
        slave.fmu.terminate()
    finally:
        slave.fmu.freeInstance()


def bench(exported: Exported, queued: list[float]) -> SimulatedRig:
    draw = SETTINGS.draw(LAB, ticks=TICKS + 1)
    start, limits = exported.controller.first_state, exported.reference.limits
    return SimulatedRig(draw, SETTINGS.bench, limits=limits, start=start, queued=queued)


def test_the_unit_is_as_the_standard_has_it(exported: Exported) -> None:
    assert validation.validate_fmu(str(exported.unit)) == []
    described = fmpy.read_model_description(str(exported.unit))
    assert described.fmiVersion == "2.0"
    assert described.coSimulation.modelIdentifier == "dpc_2_turn"
    assert described.defaultExperiment.stepSize == repr(PERIOD)
    assert exported.made.lacks == ""
    names = zipfile.ZipFile(exported.unit).namelist()
    assert "sources/fmu.c" in names
    assert any(name.startswith("binaries/") for name in names)
    assert {one.unit for one in described.modelVariables} <= {"rad", "rad/s", "m", "m/s", "m/s2", "s", None}


def test_its_functions_are_those_of_the_standards_headers(exported: Exported, tmp_path: Path) -> None:
    headers = Path(fmpy.__file__).parent / "c-code"
    with zipfile.ZipFile(exported.unit) as archive:
        archive.extractall(tmp_path)
    compilers = [compiler for compiler in ("gcc", "clang") if shutil.which(compiler)]
    for compiler in compilers:
        strict = [compiler, "-fsyntax-only", "-pedantic", "-Wall", "-Wextra", "-Werror"]
        subprocess.run([*strict, "-std=c99", "fmu.c"], cwd=tmp_path / "sources", check=True)
        official = ["-std=c11", f"-I{headers}", "-include", "fmi2Functions.h"]
        subprocess.run([*strict, *official, "fmu.c"], cwd=tmp_path / "sources", check=True)


def test_on_the_plant_it_is_the_exported_c_to_the_last_bit(exported: Exported, tmp_path: Path) -> None:
    ticker = library_ticker(Assembly(exported.reference, LAB, SETTINGS, law=exported.controller), exported.library)
    program, queued = ticker.program, ticker.queued[:, 0].tolist()
    rig = bench(exported, queued)
    with running(exported, tmp_path) as slave:
        assert slave.get("command") == queued[-1]
        for k in range(TICKS + 1):
            reading = rig.read()
            # Some ticks have no reading of the cart's scale.
            present = np.array([True, True, k % 7 != 3])
            for joint, position, there in zip(JOINTS, reading.positions.tolist(), present.tolist(), strict=True):
                slave.set(f"measured_{joint}", position)
                slave.set(f"present_{joint}", there)
            slave.set("limit_switch", int(reading.switch))
            slave.step(k * PERIOD)
            ticker(k, reading._replace(present=present))
            told = program._told
            assert {name: slave.get(name) for name in SCALARS} == {name: told[name].item() for name in SCALARS}
            extras = program.equations.filter.extra_names
            for name, prefix in VECTORS.items():
                known = [*STATES, *extras] if name == "sigmas" else STATES
                assert slave.all(prefix, known) == told[name].tolist()
            if extras:
                assert slave.all("", extras) == told["extra"].tolist()
            rig.command(slave.get("command"))
        assert slave.get("stopped_by") == 0
        assert slave.get("status") == 1
    # It has flown.
    assert np.abs(rig.truth[:2] - exported.controller.reference_states[-1, :2]).max() < 0.1


def test_a_step_of_several_periods_is_as_many_steps_with_the_same_inputs(exported: Exported, tmp_path: Path) -> None:
    with running(exported, tmp_path / "a") as long, running(exported, tmp_path / "b") as short:
        # A clock that adds its steps is off by some roundings.
        begin = 0.0
        for periods in (1, 2, 7, 1, 64):
            for one in (long, short):
                one.set("measured_cart", 1e-4 * periods)
            long.step(begin, periods * PERIOD)
            for k in range(periods):
                short.step(begin + k * PERIOD)
            begin += periods * PERIOD
            assert long.all("", SCALARS) == short.all("", SCALARS)


def test_steps_that_divide_the_period_keep_the_outputs_and_others_are_rejected(
    exported: Exported, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    with running(exported, tmp_path / "a", start=2.0) as halves, running(exported, tmp_path / "b") as wholes:
        for one in (halves, wholes):
            one.set("measured_cart", 0.0)
        for k in range(20):
            wholes.step(k * PERIOD)
            halves.step(2.0 + k * PERIOD, PERIOD / 2)
            assert halves.get("command") == wholes.get("command")
            halves.set("measured_cart", 0.01)
            halves.step(2.0 + (k + 0.5) * PERIOD, PERIOD / 2)
            assert halves.get("command") == wholes.get("command")
            halves.set("measured_cart", 0.0)
    wrong = ([2.5 * PERIOD], [0.7 * PERIOD, 0.7 * PERIOD], [PERIOD / 2, 2 * PERIOD], [0.0], [np.nan], [np.inf])
    for number, sizes in enumerate(wrong):
        with running(exported, tmp_path / f"{number}") as slave:
            for k, size in enumerate(sizes[:-1]):
                slave.step(k * size, size)
            with pytest.raises(Exception, match="DoStep"):
                slave.step(sum(sizes[:-1]), sizes[-1])
            assert capsys.readouterr().out.startswith("[ERROR] ")
            slave.fmu.reset()
            slave.step(0.0)
