"""The paper's computational figures, redrawn and listed by name in `registry`."""
