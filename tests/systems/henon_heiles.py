"""The Hénon–Heiles system, as the example writes it."""

from dpcontrol.examples.henon_heiles import hamiltonian, henon_heiles

__all__ = ["hamiltonian", "henon_heiles"]
