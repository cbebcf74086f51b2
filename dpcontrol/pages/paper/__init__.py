"""Pages of the paper's computational figures, one module for each."""
