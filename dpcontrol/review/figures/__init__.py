"""The paper's computational figures, redrawn: one module for each, listed by name in `registry`."""
