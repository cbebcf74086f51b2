"""casadi expressions as heyoka expressions, so that a model is written once.

A casadi function is a list of elementary instructions on a work vector; walking it rebuilds the same graph in
heyoka, common subexpressions included.
"""

from collections.abc import Sequence

import casadi as ca
import heyoka as hy

_UNARY = {
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
    ca.OP_FABS: lambda a: hy.select(hy.gte(a, hy.expression(0.0)), a, -a),
}
_BINARY = {
    ca.OP_ADD: lambda a, b: a + b,
    ca.OP_SUB: lambda a, b: a - b,
    ca.OP_MUL: lambda a, b: a * b,
    ca.OP_DIV: lambda a, b: a / b,
    ca.OP_POW: lambda a, b: a**b,
    ca.OP_CONSTPOW: lambda a, b: a**b,
    ca.OP_ATAN2: hy.atan2,
}


def to_heyoka(function: ca.Function, arguments: Sequence[Sequence[hy.expression]]) -> list[hy.expression]:
    """Return the entries of the function's only output, with `arguments[i][k]` for entry k of input i.

    Raises:
        NotImplementedError: the graph holds an operation that has no counterpart here; names it.
    """
    work: dict[int, hy.expression] = {}
    rows, columns = function.sparsity_out(0).get_triplet()
    height = function.size1_out(0)
    # Structural zeros are missing from the instructions.
    out = [hy.expression(0.0) for _ in range(height * function.size2_out(0))]
    for k in range(function.n_instructions()):
        operation = function.instruction_id(k)
        into, source = function.instruction_output(k), function.instruction_input(k)
        if operation == ca.OP_CONST:
            work[into[0]] = hy.expression(float(function.instruction_constant(k)))
        elif operation == ca.OP_INPUT:
            work[into[0]] = arguments[source[0]][source[1]]
        elif operation == ca.OP_OUTPUT:
            out[rows[into[1]] + height * columns[into[1]]] = work[source[0]]
        elif operation in _UNARY:
            work[into[0]] = _UNARY[operation](work[source[0]])
        elif operation in _BINARY:
            work[into[0]] = _BINARY[operation](work[source[0]], work[source[1]])
        else:
            raise NotImplementedError(
                f"casadi operation {operation} in {function.name()} has no heyoka counterpart; add it to "
                "dpcontrol.dynamics.taylor"
            )
    return out
