"""Equilibria, Lyapunov orbits, their tubes, cuts and connections."""
