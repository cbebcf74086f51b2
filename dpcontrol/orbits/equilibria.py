"""Equilibria of a system: energy, eigenvalues and what kind of point each is."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from dpcontrol.dynamics.system import System, saddle_index

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Equilibrium:
    """state (N,), energy in J, eigenvalues (N,) in 1/s, kind: "centre" or "index-k saddle"."""

    name: str
    state: Array
    energy: float
    eigenvalues: NDArray[np.complex128]
    kind: str


def equilibrium(system: System, name: str) -> Equilibrium:
    """Describe the named equilibrium.

    Raises:
        InputError: there is no equilibrium of that name.
    """
    state = system.equilibrium(name)
    eigenvalues = np.asarray(np.linalg.eigvals(system.numeric.jacobian(state)), dtype=complex)
    index = saddle_index(system.numeric, state)
    order = np.lexsort((np.imag(eigenvalues), -np.real(eigenvalues)))
    return Equilibrium(
        name=name,
        state=state,
        energy=float(system.numeric.hamiltonian(state)),
        eigenvalues=eigenvalues[order],
        kind="centre" if index == 0 else f"index-{index} saddle",
    )


def equilibria(system: System) -> dict[str, Equilibrium]:
    """Describe every equilibrium of the system, by name."""
    return {name: equilibrium(system, name) for name in system.equilibria}
