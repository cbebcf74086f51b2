"""A user's law as casadi expressions.

It is part of the compiled tick, and so of lockstep runs, margins, C and FMU as well:

    command, m⁺ = function(x̂, reference, m, parameters)

x̂ (N,) is the state ahead, m (M,) the law's own memory. The reference is that of the same time. The feedback of a tick
is the command less the reference's feedforward.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, fields, replace
from typing import Any, NamedTuple

import casadi as ca
import numpy as np

from dpcontrol.control.interface import GainSchedule, SampledModel
from dpcontrol.control.tracking import FeedforwardSettings, TimedController, tracking_controller
from dpcontrol.dynamics.compiled import check_operations
from dpcontrol.foundation.errors import InputError
from dpcontrol.references.reference import Reference


class Setpoint(NamedTuple):
    """Target of a law.

    State (N,), and feedforward, the cart's acceleration along the reference, m/s².
    """

    state: Any
    feedforward: Any


class SymbolicLaw:
    """A law of casadi expressions, to be given as `controller=`.

    Args:
        function: `function(state, reference, memory, parameters)` returns the cart's acceleration in m/s², and the next
            memory, as expressions of casadi's SX. `state` (N,) is the estimate when the command acts. `reference` has
            `state` (N,) and `feedforward` in m/s². `memory` has M entries. `parameters` are the base parameters.
        memory: entries M of the law's memory.
        first: first values (M,) of the memory, zero by default.

    Raises:
        InputError: `function` cannot be called, or `first` has another length.
    """

    def __init__(
        self,
        function: Callable[[ca.SX, Setpoint, ca.SX, ca.SX], tuple[Any, Any]],
        *,
        memory: int = 0,
        first: Sequence[float] | None = None,
    ) -> None:
        """Check and keep the function, with the first values of its memory; arguments see the class."""
        self.__name__ = getattr(function, "__name__", type(function).__name__)
        if not callable(function):
            raise InputError(f"controller: {function!r} is not a function(state, reference, memory, parameters)")
        self.function, self.first = function, np.zeros(memory) if first is None else np.array(first, dtype=float)
        if self.first.shape != (memory,) or not np.isfinite(self.first).all():
            raise InputError(
                f"controller = {self.__name__}: first = {first!r}: must be {memory} finite numbers, as memory"
            )

    def __repr__(self) -> str:
        return f"<law {self.__name__}: expressions with {len(self.first)} numbers of memory>"

    def expression(self, states: int, parameters: int) -> ca.Function:
        """Return a user's law as a function, which the tick calls.

        (state, wanted, feedforward, memory, parameters) -> command and next memory, (1+M,). `wanted` (N,) is the
        reference's state.

        Args:
            states: number N of states.
            parameters: number of base parameters.

        Raises:
            InputError: the function raises, or returns other values than such expressions.
        """
        names, memory = ("state", "wanted", "feedforward", "memory", "parameters"), len(self.first)
        sizes = (states, states, 1, memory, parameters)
        state, reference_state, feedforward, law_memory, base_parameters = symbols = [
            ca.SX.sym(*declaration) for declaration in zip(names, sizes, strict=True)
        ]
        try:
            values = self.function(state, Setpoint(reference_state, feedforward), law_memory, base_parameters)
            if not isinstance(values, tuple | list) or len(values) != 2:
                raise TypeError("it must return two values: the command, and the next memory")
            command, following = values
            memory_after = ca.vertcat(*following) if isinstance(following, list | tuple) else ca.SX(following)
            out = ca.densify(ca.vertcat(ca.SX(command), memory_after))
            law = ca.Function("law", symbols, [out], [*names], ["out"])
            check_operations(law)
        except Exception as error:
            text = " ".join(str(error).split())
            raise InputError(f"controller = {self.__name__}: {type(error).__name__}: {text}") from error
        if out.shape != (1 + memory, 1):
            raise InputError(
                f"controller = {self.__name__}: it returned {out.shape[0]} by {out.shape[1]} numbers; it must return "
                f"one command, and {memory} of memory"
            )
        return law


@dataclass(frozen=True, eq=False)
class SymbolicController(TimedController):
    """A symbolic law on a reference, for one model.

    Its commands are computed with this model.
    """

    law: SymbolicLaw = field(kw_only=True)

    def schedule(self, lead: int) -> GainSchedule:
        """Return the reference's schedule of inputs and states with this law, whose flag is set in each row.

        Args:
            lead: number of ticks between the computation of a command and its action.
        """
        schedule, arms = super().schedule(lead), len(self.first_state) // 2 - 1
        # The column before the reference's angles is `own` in `TickEquations.row`: 1 calls the law.
        return replace(schedule, rows=np.insert(schedule.rows, -arms, 1.0, axis=1), law=self.law)


def symbolic_controller(law: SymbolicLaw, reference: Reference, model: SampledModel) -> SymbolicController:
    """Return the controller that applies a symbolic law along a reference.

    Args:
        law: the law.
        reference: reference to follow.
        model: model of arms and drive from tick to tick.

    Raises:
        InputError: the law raises, or does not return valid expressions.
    """
    law.expression(model.dimension, len(model.parameters))
    tracking = tracking_controller(reference, model, FeedforwardSettings())
    parts = {attribute.name: getattr(tracking, attribute.name) for attribute in fields(tracking)}
    return SymbolicController(**{**parts, "kind": law.__name__}, law=law)
