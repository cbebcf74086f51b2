"""Notebook-style scripts with figures, for example `python -m dpcontrol.examples.orbit`."""
