"""Blocks of ticks of a simulated run, computed without Python's arithmetic.

Each tick is four calls: of the plant's step and the controller's tick as machine code, and of casadi for drive and
sensors between them. They pass numbers in rows of arrays, one for each tick. Their results equal those of
`SimulatedRig` and `Ticker` to the last bit. Those compute the ticks that need anything else: a blow, a limit switch, an
end of the track, braking, or numbers that are not finite.
"""

from typing import Any

import numpy as np

from dpcontrol.control.bench_period import sensors_and_drive
from dpcontrol.dynamics.equations import bound_call
from dpcontrol.loop.bench import StreamReader
from dpcontrol.loop.result import Ticks
from dpcontrol.loop.simulated import SimulatedRig
from dpcontrol.loop.ticker import Ticker

BLOCK = 50
"""Ticks of a block, whose rows fit into the processor's cache."""


class Blocks:
    """The ticks of a simulated run, computed in blocks of up to `BLOCK` ticks.

    Each block is an array whose rows hold inputs and outputs of one tick, so that machine code passes numbers from row
    to row.

    Args:
        ticker: the run's controller and filter, which compute a whole tick in one call.
        rig: the bench, whose period is one expression (`SimulatedRig.kind`).
        noise: noise on the rates of the law, if any.
    """

    def __init__(self, ticker: Ticker, rig: SimulatedRig, noise: StreamReader | None) -> None:
        """Allocate the rows of a block, and bind the machine code of each tick to its rows.

        Row k of `_ticks` holds the inputs of the controller's tick k: reading, gains and references, constants and
        memory. Memory and report, its outputs, are in row k + 1. `_reading`, `_row`, `_numbers`, `_memory` and
        `_report` are these columns, and `_told` is the report by names.

        Row k of `_steps` holds the inputs of the plant's step before tick k, of which `_state` and `_acting`, the
        acceleration, are columns. `_demands` are those on their way to the drive at each tick. `_command_noise`,
        `_position_noise` and `_zeros` are the random numbers of a block, which `_fill` writes.
        """
        kind, program, tick = rig.kind, ticker.program, ticker.program.equations
        assert kind is not None
        self._ticker, self._rig, self._noise, self._kind = ticker, rig, noise, kind
        lanes, n, step = program.lanes, program.model.arms, kind.step
        sizes = [layout.size for layout in (tick.reading, tick.row, tick.numbers, tick.memory, tick.report)]
        # The outputs of a tick are the end of a row, its inputs the beginning of the row before.
        self._ticks = ticks = np.zeros((BLOCK + 1, sum(sizes), lanes))
        reading, self._row, self._numbers, self._memory, self._report = np.split(ticks, np.cumsum(sizes)[:-1], axis=1)
        self._reading = tick.reading.of_rows(reading)
        self._told = tick.report.of_rows(self._report[1:, :, 0])
        self._steps = np.zeros((BLOCK + 1, step.size_in, lanes))
        self._steps[:, step.slices["duration"]] = rig.period
        self._steps[:, step.slices["parameters"]] = rig.parameters[:, None]
        self._state, self._acting = self._steps[:, : kind.size], self._steps[:, step.slices["inputs"]]
        self._demands, self._zeros = np.zeros((BLOCK + 1, kind.demands)), np.zeros((BLOCK, n))
        self._command_noise, self._position_noise = np.zeros((BLOCK, 1)), np.zeros((BLOCK, n + 1))
        self._measured = np.array(tick.measured)[:, None]
        self._reading.present[:], self._zeros[:] = self._measured, rig.drawn(0, 1).zeros
        self._calls = [self._call(k, sum(sizes[:4]), sum(sizes[:3])) for k in range(BLOCK)]

    def _call(self, k: int, inputs: int, outputs: int) -> tuple[Any, ...]:
        """Return the buffers and calls that compute the k-th tick of a block.

        Args:
            k: index of the tick in the block.
            inputs: number of entries of a row that a tick reads.
            outputs: first entry of the next row that a tick writes.

        Returns:
            Input and output of the plant's step, the call of the sensors, input and output of the controller's tick,
                and the call of the drive.
        """
        kind, rig, reading, state = self._kind, self._rig, self._reading, self._state
        sensors, drive = sensors_and_drive(kind, self._ticks.shape[2])
        # Row -1 has the reading before the block.
        sensor_inputs = [state[k + 1], self._zeros[k], self._position_noise[k], rig.steps, rig.drive_numbers]
        sensor_inputs += [reading.present[k], reading.measured[k - 1]]
        command = self._report[k + 1, self._ticker.program.equations.report.slices.command]
        drive_inputs = [command, self._command_noise[k], self._demands[k], state[k + 1], rig.drive_numbers]
        read_sensors = bound_call(sensors, sensor_inputs, [reading.measured[k]])
        drive_call = bound_call(drive, drive_inputs, [self._demands[k + 1], self._acting[k + 1]])
        return (
            self._steps[k],
            state[k + 1],
            read_sensors,
            self._ticks[k, :inputs],
            self._ticks[k + 1, outputs:],
            drive_call,
        )

    def run(self, k: int, most: int, into: Ticks, first: int) -> int:
        """Compute ticks from k on, up to one with an outcome or news, and return their number.

        The result is 0 if `SimulatedRig` and `Ticker` must compute tick k.

        Args:
            k: the first tick.
            most: largest number of ticks.
            into: rows of the run's ticks, to which the results are written.
            first: tick of the first of these rows.
        """
        count = self._rig.plain_ticks(k, min(most, BLOCK - k % BLOCK)) if self._ticker.whole else 0
        if count:
            self._fill(k, count)
            move, tick = self._kind.step.single.__call__, self._ticker.program.whole_tick.__call__
            for plant_inputs, plant_state, read_sensors, tick_inputs, tick_outputs, drive in self._calls[:count]:
                move(plant_inputs, plant_state)
                read_sensors()
                tick(tick_inputs, tick_outputs)
                drive()
            count = self._sound(count)
        if count:
            self._take(k, count, into, slice(k - first, k - first + count))
        return count

    def _fill(self, k: int, count: int) -> None:
        """Write the inputs of `count` ticks from tick k on: the state before them, gains and random numbers."""
        rig, program, reading = self._rig, self._ticker.program, self._reading
        self._memory[0] = program.stored
        if not np.array_equal(program.constants, self._numbers[0, :, 0]):
            self._numbers[:] = program.constants[:, None]
        state, self._demands[0], last_reading, self._acting[0] = rig.stored
        self._state[0], reading.measured[-1] = state[:, None], last_reading[:, None]
        self._ticker.rows_of(k, count, self._row)
        if rig.draws:
            random_numbers = rig.drawn(k, count)
            self._command_noise[:count, 0], self._position_noise[:count], self._zeros[:count], dropped = random_numbers
            reading.present[:count] = ~dropped[:, None, None] & self._measured
        if self._noise is not None:
            reading.rate_error[:count] = [self._noise[k + i] for i in range(count)]

    def _sound(self, count: int) -> int:
        """Return the number of leading ticks of a block whose results are valid.

        They end before a state from which machine code cannot continue, or with the first outcome or news, on which
        Python must act.
        """
        report = self._told
        valid = self._rig.plain_states(self._state[1 : count + 1, :, 0]) & np.isfinite(report.command[:count, 0])
        if not valid.all():
            count = int(valid.argmin())
        notable = (report.notable + report.news + report.done)[:count, 0] != 0
        return int(notable.argmax()) + 1 if notable.any() else count

    def _take(self, k: int, count: int, into: Ticks, place: slice) -> None:
        """Write the results of a block to the run's rows, and set rig and ticker to its end.

        Args:
            k: the first tick of the block.
            count: number of its ticks.
            into: rows of the run's ticks.
            place: rows of this block in them.
        """
        ticker, program, reading, block_rows = self._ticker, self._ticker.program, self._reading, slice(1, count + 1)
        measured = np.where(reading.present[:count, :, 0] > 0, reading.measured[:count, :, 0], np.nan)
        references = ticker.references[k - ticker.began :][:count]
        into.take_block(place, measured, self._report[block_rows, :, 0], self._state[block_rows, :, 0], references)
        program.resume(self._ticks[count - 1], self._report[count], self._memory[count])
        ticker.take_carts(k, measured[:, -1])
        bench_end = self._state[count, :, 0], self._demands[count], reading.measured[count - 1, :, 0]
        self._rig.resume(k + count - 1, *bench_end, hardest=float(np.abs(self._acting[:count, 0, 0]).max()))


def blocks_of(ticker: Ticker, rig: Any, noise: StreamReader | None) -> Blocks | None:
    """Return the blocks for a run on this rig, which make it faster, or None if its ticks need Python.

    Python is needed by rigs other than `SimulatedRig`, by benches without a `kind`, by laws with an internal clock, and
    by users' objects.

    Args:
        ticker: controller and filter of the run.
        rig: any rig.
        noise: noise on the rates of the law, if any.
    """
    # A subclass can replace any part of a tick.
    is_compiled = type(rig) is SimulatedRig and rig.kind is not None and ticker.whole and not ticker.watched
    return Blocks(ticker, rig, noise) if is_compiled else None
