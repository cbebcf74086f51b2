"""Verdicts on runs: decoded flights and their scores, without drawings."""
