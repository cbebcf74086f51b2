"""Blocks of ticks of a simulated run, computed without Python's arithmetic.

Each tick is four calls: of the plant's step and the controller's tick as machine code, and of casadi for drive and
sensors between them. They pass numbers in rows of arrays, one for each tick. Their results equal those of
`SimulatedRig` and `Ticker` to the last bit. Those compute the ticks that need anything else: a blow, a limit switch, an
end of the track, braking, or numbers that are not finite.
"""

from typing import Any

import numpy as np

from dpcontrol.control.bench_period import bound, sensors_and_drive
from dpcontrol.loop.bench import StreamReader
from dpcontrol.loop.result import Ticks
from dpcontrol.loop.simulated import SimulatedRig
from dpcontrol.loop.ticker import Ticker

BLOCK = 50
"""Ticks of a block, whose rows fit into the processor's cache."""


class Blocks:
    """The ticks of a simulated run, computed in blocks.

    Args:
        ticker: the run's controller and filter, which compute a whole tick in one call.
        rig: the bench, of a `kind`.
        noise: noise on the rates of the law, if any.
    """

    def __init__(self, ticker: Ticker, rig: SimulatedRig, noise: StreamReader | None) -> None:
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
        self._alive: list[object] = []
        self._calls = [self._call(k, sum(sizes[:4]), sum(sizes[:3])) for k in range(BLOCK)]

    def _call(self, k: int, inputs: int, outputs: int) -> tuple[Any, ...]:
        """Return the arguments and calls of the k-th tick of a block."""
        kind, rig, reading, state = self._kind, self._rig, self._reading, self._state
        sensors, drive = sensors_and_drive(kind, self._ticks.shape[2])
        # Row -1 has the reading before the block.
        measured = [state[k + 1], self._zeros[k], self._position_noise[k], rig.steps, rig.drive_numbers]
        measured += [reading.present[k], reading.measured[k - 1]]
        command = self._report[k + 1, self._ticker.program.equations.report.slices.command]
        demanded = [command, self._command_noise[k], self._demands[k], state[k + 1], rig.drive_numbers]
        sense, *first = bound(sensors, measured, [reading.measured[k]])
        act, *second = bound(drive, demanded, [self._demands[k + 1], self._acting[k + 1]])
        self._alive += [*first, *second]
        return self._steps[k], state[k + 1], sense, self._ticks[k, :inputs], self._ticks[k + 1, outputs:], act

    def run(self, k: int, most: int, into: Ticks, first: int) -> int:
        """Compute ticks from k on, up to one with an outcome or news, and return their number.

        The result is 0 if `SimulatedRig` and `Ticker` must compute tick k.

        Args:
            k: the first tick.
            most: largest number of ticks.
            into: rows of the ticks.
            first: tick of its first row.
        """
        count = self._rig.plain_ticks(k, min(most, BLOCK - k % BLOCK)) if self._ticker.whole else 0
        if count:
            self._fill(k, count)
            move, tick = self._kind.step.single.__call__, self._ticker.program.whole_tick.__call__
            for begin, end, sense, given, out, act in self._calls[:count]:
                move(begin, end)
                sense()
                tick(given, out)
                act()
            count = self._sound(count)
        if count:
            self._take(k, count, into, slice(k - first, k - first + count))
        return count

    def _fill(self, k: int, count: int) -> None:
        """Write the inputs of ticks from k on."""
        rig, program, reading = self._rig, self._ticker.program, self._reading
        self._memory[0] = program.stored
        if not np.array_equal(program.constants, self._numbers[0, :, 0]):
            self._numbers[:] = program.constants[:, None]
        state, self._demands[0], last, self._acting[0] = rig.stored
        self._state[0], reading.measured[-1] = state[:, None], last[:, None]
        self._ticker.rows_of(k, count, self._row)
        if rig.draws:
            drawn = rig.drawn(k, count)
            self._command_noise[:count, 0], self._position_noise[:count], self._zeros[:count], dropped = drawn
            reading.present[:count] = ~dropped[:, None, None] & self._measured
        if self._noise is not None:
            reading.rate_error[:count] = [self._noise[k + i] for i in range(count)]

    def _sound(self, count: int) -> int:
        """Return the number of ticks that need nothing else, up to the first one with an outcome or news."""
        told = self._told
        sound = self._rig.plain_states(self._state[1 : count + 1, :, 0]) & np.isfinite(told.command[:count, 0])
        if not sound.all():
            count = int(sound.argmin())
        notable = (told.notable + told.news + told.done)[:count, 0] != 0
        return int(notable.argmax()) + 1 if notable.any() else count

    def _take(self, k: int, count: int, into: Ticks, place: slice) -> None:
        """Write rows of ticks from k on, and hand over to rig and ticker."""
        ticker, program, reading, done = self._ticker, self._ticker.program, self._reading, slice(1, count + 1)
        measured = np.where(reading.present[:count, :, 0] > 0, reading.measured[:count, :, 0], np.nan)
        references = ticker.references[k - ticker.began :][:count]
        into.take_block(place, measured, self._report[done, :, 0], self._state[done, :, 0], references)
        program.resume(self._ticks[count - 1], self._report[count], self._memory[count])
        ticker.take_carts(k, measured[:, -1])
        last = self._state[count, :, 0], self._demands[count], reading.measured[count - 1, :, 0]
        self._rig.resume(k + count - 1, *last, hardest=float(np.abs(self._acting[:count, 0, 0]).max()))


def blocks_of(ticker: Ticker, rig: Any, noise: StreamReader | None) -> Blocks | None:
    """Return the blocks of a run on this rig, or None if its ticks need Python.

    Args:
        ticker: controller and filter of the run.
        rig: any rig.
        noise: noise on the rates of the law, if any.
    """
    # A subclass can replace any part of a tick.
    simple = type(rig) is SimulatedRig and rig.kind is not None and ticker.whole and not ticker.watched
    return Blocks(ticker, rig, noise) if simple else None
