"""casadi functions as machine code, and a plant's step.

The functions are for one point or for many at once. The step has a fixed length.

A casadi function is a list of elementary instructions on a work vector. This module rebuilds the same graph in heyoka,
common subexpressions included, so that a model is written once. LLVM compiles it twice: for one point, and for a full
vector of the processor. A call for one point takes a third of the time of casadi's interpreter. Among hundreds, a point
takes a fiftieth.

    k_i = f(x + h Σ_{j<i} a_ij k_j, u; p),      x⁺ = x + h Σ_i b_i k_i        (DOP853: 12 stages, order 8)

The step's length is an input, so one function covers whole periods, parts of them and many plants at once. At 1 ms the
double pendulum's error is round-off.

Sources: Biscani & Izzo, Revisiting high-order Taylor methods for astrodynamics and celestial mechanics (2021), section
3. Hairer, Nørsett & Wanner, Solving Ordinary Differential Equations I (1993), section II.5.
"""

import platform
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from functools import cache, cached_property, partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import casadi as ca
import numpy as np

from dpcontrol.dynamics.equations import Equations, PointCalls
from dpcontrol.foundation.arrays import Array
from dpcontrol.foundation.cache import cache_file, compiler_folder, keep, kept, load_or_make
from dpcontrol.foundation.errors import remark
from dpcontrol.foundation.files import content_hash
from dpcontrol.foundation.parts import Later, installed

if TYPE_CHECKING:
    import heyoka as hy
else:
    hy = Later("heyoka", lambda heyoka: _settle(heyoka))


COMPACT: dict[str, Any] = {"compact_mode": True, "opt_level": 1}
"""heyoka's options of compilation. Code of a controller's tick is compiled five times faster than straight-line code
with the highest optimisation, and runs as fast: it stays in the processor's cache."""

QUICK: dict[str, Any] = {"compact_mode": False, "opt_level": 0}
"""Options for few equations of low order: straight-line code that is not optimised runs as fast as that of `COMPACT`
and compiles four times faster."""

_VERSION = "2"
"""Version of this module's code, part of the cache keys of what it compiles: raise it whenever the code changes."""


def _settle(heyoka: Any) -> None:
    """Configure heyoka at its first use.

    Its machine code goes to this program's cache, and its log messages do not reach stdout.
    """
    # heyoka logs to stdout, which would corrupt JSON output.
    heyoka.set_logger_level_critical()
    state, folder = heyoka.llvm_state, compiler_folder()
    if folder is not None:
        state.set_diskcache_path(folder)
        try:
            if folder.exists():
                state.get_diskcache_size()
        except RuntimeError as error:
            folder = None
            remark(f"heyoka's cache is not readable: {error}; clear it with `dpcontrol cache --clear`")
    state.set_diskcache_enabled(folder is not None)


@cache
def _operations() -> tuple[dict[int, Any], dict[int, Any]]:
    """Return heyoka's counterparts, by casadi's operation codes, of smooth operations and of switches.

    Switches have kinks and jumps. They belong to decisions, not to motions, whose Taylor series they would end.
    """
    zero = hy.expression(0.0)
    smooth = {
        ca.OP_ASSIGN: lambda a: a,
        ca.OP_NEG: lambda a: -a,
        ca.OP_EXP: hy.exp,
        ca.OP_LOG: hy.log,
        ca.OP_SQRT: hy.sqrt,
        ca.OP_SQ: lambda a: a * a,
        ca.OP_TWICE: lambda a: a + a,
        ca.OP_INV: lambda a: hy.expression(1.0) / a,
        ca.OP_SIN: hy.sin,
        ca.OP_COS: hy.cos,
        ca.OP_TAN: hy.tan,
        ca.OP_ASIN: hy.asin,
        ca.OP_ACOS: hy.acos,
        ca.OP_ATAN: hy.atan,
        ca.OP_SINH: hy.sinh,
        ca.OP_COSH: hy.cosh,
        ca.OP_TANH: hy.tanh,
        ca.OP_FABS: lambda a: hy.select(hy.gte(a, zero), a, -a),
        ca.OP_ADD: lambda a, b: a + b,
        ca.OP_SUB: lambda a, b: a - b,
        ca.OP_MUL: lambda a, b: a * b,
        ca.OP_DIV: lambda a, b: a / b,
        ca.OP_POW: lambda a, b: a**b,
        ca.OP_CONSTPOW: lambda a, b: a**b,
        ca.OP_ATAN2: hy.atan2,
    }
    switches = {
        ca.OP_NOT: lambda a: hy.eq(a, zero),
        ca.OP_LT: hy.lt,
        ca.OP_LE: hy.lte,
        ca.OP_EQ: hy.eq,
        ca.OP_NE: hy.neq,
        ca.OP_AND: lambda a, b: hy.logical_and([a, b]),
        ca.OP_OR: lambda a, b: hy.logical_or([a, b]),
        ca.OP_FMIN: lambda a, b: hy.select(hy.lt(a, b), a, b),
        ca.OP_FMAX: lambda a, b: hy.select(hy.gt(a, b), a, b),
        ca.OP_IF_ELSE_ZERO: lambda a, b: hy.select(a, b, zero),
    }
    return smooth, switches


def interpreted(
    function: ca.Function,
    arguments: Sequence[Sequence[Any]],
    *,
    constant: Callable[[float], Any],
    applied: Callable[..., Any],
    zero: Any,
) -> list[list[Any]]:
    """Evaluate a casadi function in another arithmetic, such as heyoka's expressions or ball arithmetic.

    Args:
        function: casadi function of scalar expressions.
        arguments: values, [i][k] for entry k of input i.
        constant: function that converts a number.
        applied: function of one of casadi's operations and its one or two arguments.
        zero: value of structural zeros, which are missing from the instructions.

    Returns:
        the entries of each output, [i][k], in column-major order.
    """
    memory: dict[int, Any] = {}
    nonzeros = [function.sparsity_out(i).get_triplet() for i in range(function.n_out())]
    outputs = [[zero] * function.numel_out(i) for i in range(function.n_out())]
    for k in range(function.n_instructions()):
        operation = function.instruction_id(k)
        target, source = function.instruction_output(k), function.instruction_input(k)
        if operation == ca.OP_CONST:
            memory[target[0]] = constant(function.instruction_constant(k))
        elif operation == ca.OP_INPUT:
            memory[target[0]] = arguments[source[0]][source[1]]
        elif operation == ca.OP_OUTPUT:
            rows, columns = nonzeros[target[0]]
            outputs[target[0]][rows[target[1]] + function.size1_out(target[0]) * columns[target[1]]] = memory[source[0]]
        else:
            memory[target[0]] = applied(operation, *(memory[i] for i in source))
    return outputs


def to_heyoka(
    function: ca.Function, arguments: "Sequence[Sequence[hy.expression]]", *, switches: bool = False
) -> "list[hy.expression]":
    """Return the entries of a function's only output as heyoka's expressions, which its integrators and compiler take.

    Args:
        function: casadi function with one output.
        arguments: expressions, [i][k] for entry k of input i.
        switches: True to allow comparisons and conditional values.

    Raises:
        NotImplementedError: names an operation of the graph without a counterpart.
    """
    smooth, switching = _operations()
    available = smooth | switching if switches else smooth

    def applied(operation: int, *values: Any) -> Any:
        """Apply heyoka's counterpart of a casadi operation, by its code, to its one or two arguments."""
        if operation not in available:
            raise NotImplementedError(
                f"casadi operation {operation} in {function.name()} has no heyoka counterpart; add it to "
                "dpcontrol.dynamics.compiled"
            )
        return available[operation](*values)

    return interpreted(
        function,
        arguments,
        constant=lambda number: hy.expression(float(number)),
        applied=applied,
        zero=hy.expression(0.0),
    )[0]


def check_operations(function: ca.Function) -> None:
    """Reject a function that cannot be compiled, before a run needs it.

    Args:
        function: casadi function of column vectors.

    Raises:
        NotImplementedError: names the operation.
    """
    if _HEYOKA:
        sizes = [function.size1_in(i) for i in range(function.n_in())]
        to_heyoka(function, [[hy.expression(0.0)] * size for size in sizes], switches=True)


_HEYOKA = installed("heyoka")
VECTOR = 8 if _HEYOKA else 1
"""Doubles per instruction: the widest vector of current processors, which others split.

casadi's interpreter handles one."""
SINGLE = 2 if _HEYOKA else 1
"""Doubles per instruction for a single run: scalar functions round differently, and `VECTOR` takes twice as long."""


class Compiled:
    """A casadi function as machine code, for the controller's tick and for plants.

    Its inputs are dense column vectors, and it has one dense output.

    All inputs are contiguous in one array, each at its slice in `slices`. The function is compiled at its
    first call and cannot be shared between threads. Without heyoka, casadi's interpreter replaces it.

    Args:
        function: function to compile.
        options: `QUICK` for a function that is called only a few times, default `COMPACT`. They round differently.
    """

    def __init__(self, function: ca.Function, options: Mapping[str, Any] = COMPACT) -> None:
        self.function, self._options = function, options
        sizes = [function.size1_in(i) for i in range(function.n_in())]
        ends = np.cumsum(sizes)
        self.slices = {
            function.name_in(i): slice(int(ends[i] - sizes[i]), int(ends[i])) for i in range(function.n_in())
        }
        """Index of each input by name."""
        self.size_in = int(ends[-1])
        self.size_out = int(function.numel_out(0))

    @cached_property
    def machine(self) -> Any:
        """The compiled call with the same arguments, for loops without other calls."""
        return self._compiled(VECTOR)

    @cached_property
    def single(self) -> Any:
        """The same call for arrays of `SINGLE` columns, which it rounds like `machine`."""
        return self._compiled(SINGLE)

    def _compiled(self, width: int) -> Any:
        """Return machine code that evaluates `width` points per instruction, from the cache or compiled now.

        Without heyoka, it is the call of casadi's interpreter with the same arguments.
        """
        if not _HEYOKA:
            return _ByCasadi(self.function)

        def make() -> Any:
            """Compile the function."""
            variables = [hy.expression(f"v{i}") for i in range(self.size_in)]
            outputs = to_heyoka(self.function, [variables[place] for place in self.slices.values()], switches=True)
            return hy.cfunc(outputs, variables, batch_size=width, force_avx512=True, **self._options)

        file = _kept_at(self.function, f"{self.function.name()}-{width}-{self._options['opt_level']}")
        return make() if file is None else load_or_make(file, make)

    def __call__(self, inputs: Array, out: Array) -> Array:
        """Evaluate the function into `out`, and return it.

        `inputs` are (size_in,) or (size_in, S), and `out` is (size_out,) or (size_out, S).
        """
        # By position: a name costs a third of the call.
        return self.machine(inputs, out)


class _ByCasadi:
    """A casadi function on casadi's interpreter, without heyoka, with the call of `Compiled.machine`.

    It is three times slower for one point and fifty times among hundreds. It rounds a little differently.
    """

    def __init__(self, function: ca.Function) -> None:
        symbols = function.sx_in()
        self._calls = PointCalls(ca.Function(function.name(), symbols, [ca.densify(function(*symbols))]))

    def __call__(self, inputs: Array, out: Array) -> Array:
        """Evaluate the function as `Compiled` does: inputs (size_in,) or (size_in, S) into `out`, which is returned."""
        evaluate, arrays, result = self._calls.of(1 if inputs.ndim == 1 else inputs.shape[1])
        first = 0
        for array in arrays:
            end = first + array.shape[1]
            array[:] = inputs[first:end].T
            first = end
        evaluate()
        out[...] = result.T.reshape(out.shape)
        return out


def first_use(function: ca.Function, kind: str) -> bool:
    """True if a kind of code is needed for the first time on this computer, so that quick compilation pays.

    This call counts as a use. Where uses cannot be counted, the result is False.

    Args:
        function: casadi function of the code.
        kind: which of its codes.
    """
    file = _kept_at(function, kind)
    if file is None or kept(file) is not None:
        return False
    keep(file, b"")
    return True


def _kept_at(function: ca.Function, kind: str) -> Path | None:
    """Return the cache file of one kind of a function's machine code, or None if the processor is unknown.

    Compiling takes four times as long as reading. The code is specific to this processor and to all compiler versions.
    """
    processor = _processor()
    if not processor:
        return None
    key = content_hash(function.serialize(), kind, _VERSION, hy.__version__, ca.CasadiMeta.version(), processor)
    return cache_file("machine-code", kind, key)


@cache
def _processor() -> str:
    """Return a text that identifies the processor and its features on Linux, empty on other systems."""
    with suppress(OSError):
        lines = Path("/proc/cpuinfo").read_text(encoding="utf-8").split("\n\n")[0].splitlines()
        return platform.machine() + "".join(
            line for line in lines if line.startswith(("model name", "flags", "Features"))
        )
    return ""


def fixed_step(equations: Equations) -> ca.Function:
    """Return the plant's step of DOP853 over a duration with constant inputs, as a casadi function.

    It maps (state (N,), inputs (m,), duration, parameters (p,)) to the following state (N,). The duration is in s.

    Args:
        equations: equations with N states.
    """
    # Cached with its machine code because the tableau is in scipy.integrate, which takes long to import.
    key = content_hash(equations.function().serialize(), _VERSION, ca.CasadiMeta.version())
    return load_or_make(cache_file("machine-code", "expression", key), partial(_fixed_step, equations))


def _fixed_step(equations: Equations) -> ca.Function:
    """Return the step of `fixed_step` without the cache."""
    from scipy.integrate import DOP853

    f, (x, u, p) = equations.function(), (equations.state, equations.inputs, equations.parameters)
    h, no_shift = ca.SX.sym("h"), ca.SX.zeros(equations.dimension)
    stages: list[ca.SX] = []
    for coefficients in DOP853.A[: DOP853.n_stages].tolist():
        shift = sum((a * k for a, k in zip(coefficients, stages, strict=False) if a), no_shift)
        stages.append(f(x + h * shift, u, p))
    mean_slope = sum((b * k for b, k in zip(DOP853.B.tolist(), stages, strict=True) if b), no_shift)
    names = ["state", "inputs", "duration", "parameters"]
    return ca.Function("fixed_step", [x, u, h, p], [ca.cse(ca.densify(x + h * mean_slope))], names, ["following"])


def compiled_step(equations: Equations) -> Compiled:
    """Return `fixed_step` as machine code, for one plant (M,) or many (M, S).

    Args:
        equations: equations with N states.
    """
    return Compiled(fixed_step(equations))
