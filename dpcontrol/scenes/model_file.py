"""Identified arms as a model file: where each number comes from, and how well it is known."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from dpcontrol.dynamics.base_ratios import ratio_names, unit_name
from dpcontrol.foundation.files import write_whole
from dpcontrol.lab.identification import Identification


def model_text(found: Identification, *, title: str, logs: Sequence[str], starting_model: str) -> str:
    """Return the TOML text of what was identified from `logs`, started at the model of that name."""
    arms, count = found.arms, len(ratio_names(found.arms))
    left = np.array([s.rms for s in found.segments if not s.used])
    # A comment ends with its line, whatever a file is called.
    of = _plain(f"Identified from {', '.join(logs)}")
    starting_model = _plain(starting_model)
    known = np.isfinite(np.diag(found.covariance)[:count])
    # A file of numbers has no infinity: what the data do not see is not varied.
    covariance = np.where(np.outer(known, known), found.covariance[:count, :count], 0.0)
    lines = [
        f"# {of}, starting at the model {starting_model}.",
        f"# {len(left)} segments were left out; their rms is {1e3 * np.median(left):.2f} mrad in the median, "
        f"{1e3 * left.max():.2f} at worst.",
        "# What the recordings do not determine:",
        *(f"#   {sentence}" for sentence in found.undetermined),
        f"title = {_quoted(title)}",
        'system = "arm-chain"',
        "",
        "[arms]   # the nearest to the starting model's with the identified ratios",
        f"source = {_quoted(f'{of}: only ratios to {unit_name(arms.count)}; the rest as in {starting_model}')}",
        *(f"{name} = {_numbers(getattr(arms, name))}" for name in ("mass", "centre_of_mass", "length", "inertia")),
        "",
        "[gravity]",
        f"source = {_quoted(f'Taken from the model {starting_model}; recordings on a clamped cart do not tell it')}",
        f"acceleration = {arms.gravity!r}",
        "",
        "[friction]",
        f"source = {_quoted(f'{of}; laws chosen by the error on segments left out')}",
        f"viscous = {_numbers(arms.viscous)}   # N m s/rad",
    ]
    units = {"coulomb": "N m", "quadratic": "N s²/m², of the air, at each arm's centre of oscillation"}
    lines += [f"{law} = {_numbers(getattr(arms, law))}   # {units[law]}" for law in arms.friction]
    if arms.friction:
        lines.append(f"smoothing = {arms.smoothing!r}   # rad/s")
    if "zeros" in found.candidates[found.chosen].terms:
        lines += [
            "",
            "[encoders]   # what recorded absolute angles show where the true ones are zero",
            f"source = {_quoted(of)}",
            f"zeros = {_numbers(found.zeros.mean(axis=0))}   # rad",
        ]
    lines += [
        "",
        "[uncertainty]   # covariance of the ratios, row by row; what is not determined is not varied",
        f"source = {_quoted(f'{of}; residuals taken as alike over blocks')}",
        "names = [" + ", ".join(_quoted(name) for name in found.names[:count]) + "]",
        "covariance = [",
        *("    " + ", ".join(repr(float(v)) for v in row) + "," for row in covariance),
        "]",
        "",
    ]
    return "\n".join(lines)


def write_model(found: Identification, path: Path, *, title: str, logs: Sequence[str], starting_model: str) -> Path:
    """Write what was identified as a model file and return its path.

    Raises:
        InputError: the file cannot be written.
    """
    write_whole(path, model_text(found, title=title, logs=logs, starting_model=starting_model))
    return path


def _quoted(text: str) -> str:
    return '"' + _plain(text).replace("\\", "\\\\").replace('"', '\\"') + '"'


def _plain(text: str) -> str:
    return "".join(c if c.isprintable() else " " for c in text)


def _numbers(values: Sequence[float] | np.ndarray) -> str:
    return "[" + ", ".join(repr(float(v)) for v in values) + "]"
