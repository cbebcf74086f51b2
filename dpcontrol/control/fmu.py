"""The exported controller as a co-simulation unit of the Functional Mock-up Interface, which other tools import.

FMI 2.0 (https://fmi-standard.org), because Simulink, OpenModelica and FMPy all import its co-simulation units; 3.0
is not everywhere yet, and a unit of scalars and one fixed step gains nothing by it. The unit is the very C that
`dpcontrol.control.export` writes, behind `target/fmu.c`: in `sources` to be compiled anywhere, and as a binary for this
platform where a compiler is at hand. A step of one period does one tick with the inputs as set, and its command acts
from the step's end on: one period after the reading.
"""

import platform
import re
import shutil
import subprocess
import xml.etree.ElementTree as ET
import zipfile
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from io import BytesIO
from pathlib import Path
from tempfile import TemporaryDirectory

import dpcontrol
from dpcontrol.control.export import ControllerSource
from dpcontrol.control.interface import GainSchedule
from dpcontrol.control.tick import TickProgram
from dpcontrol.foundation.files import content_hash

_TEMPLATE = Path(__file__).with_name("target") / "fmu.c"
_COMPILED = ("dpc_controller.c", "dpc_tables.c", "fmu.c")
_SOURCES = ("dpc_controller.h", "dpc_controller.c", "dpc_tables.h", "dpc_tables.c")
_FLAGS = ("-std=c99", "-O2", "-ffp-contract=off", "-fPIC", "-shared")
_PLATFORMS = {("Linux", "x86_64"): ("linux64", ".so"), ("Darwin", "x86_64"): ("darwin64", ".dylib")}
"""Folder and ending of binaries that FMI 2.0 has a name for, and a Unix compiler makes."""
_EPOCH = (1980, 1, 1, 0, 0, 0)
_UNITS = {"rad": {"rad": 1}, "rad/s": {"rad": 1, "s": -1}, "m": {"m": 1}, "m/s": {"m": 1, "s": -1},
          "m/s2": {"m": 1, "s": -2}, "s": {"s": 1}}  # fmt: skip


@dataclass(frozen=True)
class Variable:
    """An input or output; kind: Real, Integer or Boolean; start: of an input."""

    name: str
    kind: str
    text: str
    unit: str = ""
    start: str = ""


def variables(first: Sequence[float], extras: Sequence[str]) -> list[Variable]:
    """Return a unit's variables, of each kind in the order of `target/fmu.c`.

    first (2n+2,): the reference's first state; extras: names of what is estimated besides.
    """
    n = len(first) // 2 - 1
    joints = [f"arm_{i + 1}" for i in range(n)] + ["cart"]
    starts = [*first[:n], first[2 * n]]
    states = [(f"{what}_{i + 1}", unit) for what, unit in (("angle", "rad"), ("rate", "rad/s")) for i in range(n)]
    states += [("cart_position", "m"), ("cart_velocity", "m/s")]
    deviations = [*states, *((name, "") for name in extras)]
    numbers = [
        ("command", "m/s2", "to the drive: the cart's acceleration for one period"),
        ("wish", "m/s2", "before limits: feedforward and feedback"),
        ("feedforward", "m/s2", "the reference's own"),
        ("feedback", "m/s2", "gains times the deviation"),
        ("acting", "m/s2", "in the coming period, of commands given before"),
        ("nis", "", "normalised innovation squared"),
        ("mean_nis", "", "for each position, mean over 0.2 s"),
        ("error", "rad", "largest angle's distance from the reference, mean over 1 s"),
        ("silent", "s", "since anything was measured"),
    ]
    return [
        *(Variable(f"measured_{joint}", "Real", "absolute position", "m" if joint == "cart" else "rad", repr(float(at)))
          for joint, at in zip(joints, starts, strict=True)),
        *(Variable(name, "Real", text, unit) for name, unit, text in numbers),
        *(Variable(name, "Real", "estimated", unit) for name, unit in states),
        *(Variable(f"reference_{name}", "Real", "of this tick", unit) for name, unit in states),
        *(Variable(f"ahead_{name}", "Real", "expected when the command acts", unit) for name, unit in states),
        *(Variable(f"sigma_{name}", "Real", "standard deviation", unit) for name, unit in deviations),
        *(Variable(name, "Real", "estimated") for name in extras),
        Variable("limit_switch", "Integer", "not 0 while a limit switch is touched", start="0"),
        Variable("outcome", "Integer", "of this step, enum dpc_outcome of dpc_controller.h"),
        Variable("stopped_by", "Integer", "the outcome that ended the run, else 0"),
        Variable("mode", "Integer", "enum dpc_mode"),
        Variable("used", "Integer", "positions that this step's estimate is of"),
        Variable("sensor", "Integer", "number of a stuck sensor, from 1"),
        Variable("repeats", "Integer", "steps for which it has given the same reading"),
        Variable("doubted", "Integer", "number of an extra found beyond trust, from 1"),
        Variable("status", "Integer", "enum dpc_run"),
        *(Variable(f"present_{joint}", "Boolean", "whether it was measured", start="true") for joint in joints),
        Variable("stop", "Boolean", "while the cart is brought to rest"),
        Variable("done", "Boolean", "once it has stood for 50 ms"),
        Variable("saturated", "Boolean", "where the command was cut"),
        Variable("newly_cut", "Boolean", "where that begins"),
    ]  # fmt: skip


def model_description(
    known: Sequence[Variable], *, name: str, identifier: str, guid: str, title: str, period: float, delay: float,
    ticks: int,
) -> bytes:  # fmt: skip
    """Return modelDescription.xml; delay in periods, as the controller believes."""
    more = f"; let it act {delay - 1:g} periods later" if delay > 1 else ""
    root = ET.Element("fmiModelDescription", {
        "fmiVersion": "2.0", "modelName": name, "guid": guid, "variableNamingConvention": "flat",
        "generationTool": f"dpcontrol {dpcontrol.__version__}",
        "description": f"{title}: estimator, control law and supervisor, one tick each step of {period!r} s. Commands "
        f"are to act {delay:g} periods after their readings; a step gives the command after one{more}.",
    })  # fmt: skip
    unit = ET.SubElement(root, "CoSimulation", {"modelIdentifier": identifier})
    files = ET.SubElement(unit, "SourceFiles")
    for file in _COMPILED:
        ET.SubElement(files, "File", {"name": file})
    units = ET.SubElement(root, "UnitDefinitions")
    for text, powers in _UNITS.items():
        base = ET.SubElement(units, "Unit", {"name": text})
        ET.SubElement(base, "BaseUnit", {key: str(power) for key, power in powers.items()})
    ET.SubElement(ET.SubElement(root, "LogCategories"), "Category", {"name": "logStatusError"})
    whole = {"startTime": "0", "stopTime": repr((ticks - 1) * period), "stepSize": repr(period)}
    ET.SubElement(root, "DefaultExperiment", whole)
    listed = ET.SubElement(root, "ModelVariables")
    counts, outputs = {"Real": 0, "Integer": 0, "Boolean": 0}, []
    for k, one in enumerate(known):
        role = {"causality": "input"} if one.start else {"causality": "output", "initial": "calculated"}
        discrete = {"name": one.name, "valueReference": str(counts[one.kind]), "description": one.text}
        variable = ET.SubElement(listed, "ScalarVariable", {**discrete, **role, "variability": "discrete"})
        declared = {"unit": one.unit} if one.unit else {}
        ET.SubElement(variable, one.kind, {**declared, **({"start": one.start} if one.start else {})})
        counts[one.kind] += 1
        if not one.start:
            outputs.append(str(k + 1))
    structure = ET.SubElement(root, "ModelStructure")
    for part in ("Outputs", "InitialUnknowns"):
        unknowns = ET.SubElement(structure, part)
        for index in outputs:
            # Outputs answer the inputs of the step before.
            ET.SubElement(unknowns, "Unknown", {"index": index, "dependencies": ""})
    ET.indent(root)
    return ET.tostring(root, encoding="utf-8", xml_declaration=True)


@dataclass(frozen=True)
class Unit:
    """A unit: the archive's bytes, and why it has no binary, or ""."""

    archive: bytes
    lacks: str


def controller_unit(
    source: ControllerSource, program: TickProgram, schedule: GainSchedule, *, name: str, title: str, delay: float
) -> Unit:
    """Return the unit `name` of a controller's C, which was made of this program and schedule; delay in periods."""
    template = _TEMPLATE.read_text(encoding="utf-8")
    sources = {file: text for file, text in source.files.items() if file in _SOURCES}
    guid = content_hash(template, *sources.values())
    sources["fmu.c"] = template.replace("@GUID@", guid)
    identifier = re.sub(r"\W", "_", name, flags=re.ASCII)
    identifier = identifier if identifier[:1].isalpha() else f"dpc_{identifier}"
    known = variables(schedule.references[0].tolist(), program.equations.filter.extra_names)
    described = model_description(
        known, name=name, identifier=identifier, guid=guid, title=title, period=program.period, delay=delay,
        ticks=len(schedule.rows),
    )  # fmt: skip
    binary, lacks = _binary(sources)
    stream = BytesIO()
    with zipfile.ZipFile(stream, "w", zipfile.ZIP_DEFLATED) as archive:
        _add(archive, "modelDescription.xml", described)
        for file, text in sources.items():
            _add(archive, f"sources/{file}", text.encode())
        if binary is not None:
            folder, ending = _PLATFORMS[_here()]
            _add(archive, f"binaries/{folder}/{identifier}{ending}", binary)
    return Unit(stream.getvalue(), lacks)


def _here() -> tuple[str, str]:
    return platform.system(), platform.machine()


def _add(archive: zipfile.ZipFile, name: str, content: bytes) -> None:
    # The same content gives the same bytes.
    entry = zipfile.ZipInfo(name, _EPOCH)
    entry.compress_type, entry.external_attr = zipfile.ZIP_DEFLATED, 0o644 << 16
    archive.writestr(entry, content)


def _binary(sources: Mapping[str, str]) -> tuple[bytes | None, str]:
    """Return the shared library for this platform, or why there is none."""
    if _here() not in _PLATFORMS:
        return None, f"FMI 2.0 has no name for a binary of {' '.join(_here())}: the unit has its sources only"
    compiler = next(filter(None, map(shutil.which, ("gcc", "cc", "clang"))), None)
    if compiler is None:
        return None, "there is no C compiler here: the unit has its sources only, which tools can compile"
    with TemporaryDirectory(prefix="dpcontrol-") as name:
        folder = Path(name)
        for file, text in sources.items():
            (folder / file).write_text(text, encoding="utf-8")
        command = [compiler, *_FLAGS, "-o", "unit", *_COMPILED, "-lm"]
        done = subprocess.run(command, cwd=folder, capture_output=True, text=True, check=False)
        if done.returncode:
            why = (done.stderr.strip().splitlines() or ["it does not say why"])[0]
            return None, f"{compiler} did not compile the unit ({why}): it has its sources only"
        return (folder / "unit").read_bytes(), ""
