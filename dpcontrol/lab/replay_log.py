"""A replay as a log: measured and estimated motion, and as the reference the predicted one."""

from pathlib import Path

import numpy as np

from dpcontrol.lab.recordings import REPLAYED, SUMMARY, described, measured_rates
from dpcontrol.lab.replay import Replay, driven
from dpcontrol.logs import LogWriter, Mode, control_fields


def write_replay(result: Replay, path: Path | str, *, model: str, model_text: str) -> Path:
    """Write measured angles with the estimate and, as the reference, the prediction; return the log's path.

    Where the cart moved, estimate and prediction hold its motion as the input that it was.

    Raises:
        InputError: the file cannot be written.
    """
    recording, n = result.recording, result.recording.arms
    has_cart = recording.cart is not None
    measured, rates = recording.angles, measured_rates(recording)
    estimated, predicted, sigmas = result.estimated, result.predicted, result.sigmas
    fields = control_fields(n, has_cart=has_cart)
    control = np.zeros((len(recording.time), len(fields)))
    velocity, acceleration = driven(recording, result.carts)
    if recording.cart is not None:
        measured = np.column_stack([measured, recording.cart])
        pivot = np.column_stack([recording.cart, velocity])
        estimated, predicted = np.column_stack([estimated, pivot]), np.column_stack([predicted, pivot])
        sigmas = np.column_stack([sigmas, np.zeros_like(pivot)])
    control[:, fields.index("mode")] = Mode.IDLE
    control[:, fields.index("nis")] = result.nis
    control[:, fields.index("applied")] = acceleration
    control[:, fields.index("sigma_1") :] = sigmas
    if recording.command is not None:
        control[:, fields.index("command")] = recording.command
    metadata = described(recording, kind=REPLAYED) | {"model": model, SUMMARY: result.summary(model)}
    with LogWriter(
        path,
        arm_lengths=recording.arm_lengths,
        rate_hz=1 / recording.dt,
        has_cart=has_cart,
        metadata=metadata,
        attachments={"model.toml": model_text.encode()},
    ) as log:
        for (index, first, end), fit in zip(result.stretches, result.fits, strict=True):
            text = f"segment {index}: predicted to {1e3 * np.sqrt(np.mean(fit.residual**2)):.2f} mrad rms"
            log.event(float(recording.time[first]), "info" if fit.converged else "warn", "replay", text)
            rows = slice(first, end)
            log.ticks(
                recording.time[rows],
                measured=measured[rows],
                rates=None if rates is None else rates[rows],
                estimate=estimated[rows],
                reference=predicted[rows],
                control=control[rows],
            )
    return Path(path)
