"""Recordings of the bench: formats, mapping, checks, repairs."""
