"""Periodic orbits: Lyapunov and rotating orbits, their families."""
