"""Verdicts on runs: what was decoded of a flight, and its score; nothing here draws."""
