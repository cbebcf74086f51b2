"""Trajectory design and control for a laboratory double pendulum on a cart."""

__version__ = "0.1.0"
