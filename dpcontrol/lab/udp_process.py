"""The example bench in a process of its own, so that the loop and it share neither interpreter nor core."""

import multiprocessing
import signal
from multiprocessing.connection import Connection
from types import TracebackType

from dpcontrol.foundation.errors import InputError
from dpcontrol.lab.bench_recipe import BenchRecipe
from dpcontrol.lab.udp_bench import BenchServerSettings, UdpBench

_START = 120.0
"""Seconds for the process to load and compile."""
_END = 5.0


def _serve(recipe: BenchRecipe, settings: BenchServerSettings, pipe: Connection) -> None:
    # An interrupt from the terminal is for the loop, which stops the cart first.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    recipe.rehearse()
    arms = recipe.parameters.count
    with UdpBench(recipe.rig, arms=arms, ticks=recipe.ticks, settings=settings, say=pipe.send) as bench:
        pipe.send(bench.address)
        bench.serve(runs=1)


class BenchProcess:
    """Serves one run of the recipe's bench on loopback; a context manager, which ends the process.

    Raises:
        InputError: the process did not come up.
    """

    def __init__(self, recipe: BenchRecipe, settings: BenchServerSettings | None = None) -> None:
        context = multiprocessing.get_context("spawn")
        self._pipe, theirs = context.Pipe(duplex=False)
        self._process = context.Process(
            target=_serve, args=(recipe, settings or BenchServerSettings(), theirs), daemon=True
        )
        self._process.start()
        theirs.close()
        try:
            self.address: tuple[str, int] = self._pipe.recv() if self._pipe.poll(_START) else ("", 0)
        except EOFError:
            self.address = ("", 0)
        if not self.address[1]:
            self._end()
            raise InputError("the example bench did not start; `dpcontrol rig` shows why")
        self.said: list[str] = []
        """What the bench said of the run, once the block has been left."""

    def __enter__(self) -> "BenchProcess":
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._process.join(_END)
        try:
            while self._pipe.poll():
                self.said.append(self._pipe.recv())
        except (EOFError, OSError):
            pass
        self._end()

    def _end(self) -> None:
        if self._process.is_alive():
            self._process.terminate()
        self._process.join(_END)
        self._pipe.close()
