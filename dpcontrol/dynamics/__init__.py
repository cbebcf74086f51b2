"""Equations of motion from one Lagrangian, and propagators made from them."""
