"""Whole files of the MultiArm-Pendulum data set open by what they hold: one, two and three arms, and a moving cart."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from bench_recordings import write_csv
from numpy.typing import NDArray
from scipy.io import savemat

from dpcontrol.foundation.errors import InputError
from dpcontrol.plans.model import load_model
from dpcontrol.recordings.importing import import_recording
from dpcontrol.recordings.recording import load_recording, simulated_recording, write_recording

Array = NDArray[np.float64]

EXACT = 1e-12  # rad: the zero is shifted by π and back
STORED = 1e-9  # m, s: logs count nanoseconds, and hold doubles
PERIOD = 1e-4  # s, of the data set's recordings of one and three arms
AMPLITUDE, FREQUENCY = 0.05, 0.47  # m, Hz: the data set's cart went to and fro every 2.1 s


def _variables(angles: Array, rates: Array, times: Array) -> dict[str, Any]:
    """Return the data set's variables for several arms: one for each angle and rate, from upright."""
    named: dict[str, Any] = {"Time": times[:, None], "dt": times[1] - times[0]}
    for i in range(angles.shape[1]):
        named |= {f"Theta{i + 1}": angles[:, i : i + 1] + np.pi, f"dTheta{i + 1}": rates[:, i : i + 1]}
    return named


def _logged(values: Array, times: Array) -> dict[str, Any]:
    """Return a signal as Simulink logs it: a structure with time."""
    return {"time": times[:, None], "signals": {"values": values[:, None], "dimensions": 1.0, "label": ""}}


def _way(times: Array) -> tuple[Array, Array]:
    """Return position and velocity (K,) of a cart that moves to and fro."""
    turning = 2 * np.pi * FREQUENCY
    return AMPLITUDE * np.sin(turning * times), AMPLITUDE * turning * np.cos(turning * times)


@pytest.mark.parametrize("driven", [False, True])
def test_one_arm_logged_as_structures_opens_with_a_moving_cart(tmp_path: Path, driven: bool) -> None:
    swing = simulated_recording(load_model("single").arms, [np.array([0.8])], seconds=2.0, period=PERIOD, counts=0)
    times, angle, (cart, velocity) = swing.time, swing.angles[:, 0], _way(swing.time)
    variables = {"Theta1": _logged(angle + np.pi, times)}
    if driven:
        variables |= {"Distance": _logged(cart, times), "Velocity": _logged(velocity, times)}
    savemat(tmp_path / "single.mat", variables)
    recording = import_recording(tmp_path / "single.mat")
    assert recording.arms == 1
    assert np.abs(recording.angles[:, 0] - angle).max() <= EXACT
    assert (recording.cart is not None) == driven
    if recording.cart is not None:
        assert np.array_equal(recording.cart, cart)


@pytest.mark.parametrize("cart", ["none", "structures", "columns"])
@pytest.mark.parametrize(("model", "start"), [("lab", [1.0, -0.4]), ("triple", [0.6, 0.9, -0.5])])
def test_two_and_three_arms_open_with_the_way_of_their_cart(
    tmp_path: Path, model: str, start: list[float], cart: str
) -> None:
    swing = simulated_recording(load_model(model).arms, [np.array(start)], seconds=1.0, period=PERIOD, counts=0)
    angles, times, (way, speed) = swing.angles, swing.time, _way(swing.time)
    rates = np.gradient(angles, PERIOD, axis=0, edge_order=2)
    signals = {} if cart == "none" else {"Distance": way, "Velocity": speed}
    logged = {name: _logged(v, times) if cart == "structures" else v[:, None] for name, v in signals.items()}
    savemat(tmp_path / "whole.mat", _variables(angles, rates, times) | logged)
    recording = import_recording(tmp_path / "whole.mat")
    assert recording.arms == len(recording.arm_lengths) == len(start)
    assert recording.dt == pytest.approx(PERIOD, rel=1e-12)
    assert np.abs(recording.angles - angles).max() <= EXACT
    assert np.array_equal(recording.rates, rates)
    assert (recording.cart is None) == (cart == "none")
    assert recording.cart is None or np.array_equal(recording.cart, way)


MAPPING = """
arm_lengths = [0.17, 0.23]
[time]
column = "t"
unit = "ms"
[angles]
columns = ["inner", "outer"]
[cart]
position = "way"
unit = "mm"
command = "wanted"
"""


def test_a_cart_and_its_command_come_in_and_survive_the_log(tmp_path: Path) -> None:
    times = 1e-3 * np.arange(800)
    way = AMPLITUDE * np.sin(2 * np.pi * times)
    columns = {"t": 1e3 * times, "inner": 0.3 * np.cos(8 * times), "outer": 0.2 * np.cos(8 * times + 0.3)}
    columns |= {"way": 1e3 * way, "wanted": -((2 * np.pi) ** 2) * way}
    file, mapping = write_csv(tmp_path / "driven.csv", {k: v.tolist() for k, v in columns.items()}), tmp_path / "r.toml"
    mapping.write_text(MAPPING)
    recording = import_recording(file, str(mapping))
    again = load_recording(write_recording(recording, tmp_path / "driven.mcap"))
    for one in (recording, again):
        assert np.abs(one.cart - way).max() <= STORED
        assert np.abs(one.command + (2 * np.pi) ** 2 * way).max() <= STORED
    assert np.abs(again.time - recording.time).max() <= STORED
    with pytest.raises(InputError, match=r"is not a log .*; import a recording with `dpcontrol import` first"):
        load_recording(file)
