"""Verdicts on runs: decoded flights and their scores.

Nothing here draws.
"""
