"""The Hénon–Heiles system, as the example writes it."""

from dpcontrol.examples.henon_heiles import henon_heiles

__all__ = ["henon_heiles"]
