"""The closed loop: bench, supervisor, one run and many."""
