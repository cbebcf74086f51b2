"""Work-precision and stability charts."""
