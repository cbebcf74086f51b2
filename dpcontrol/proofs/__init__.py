"""Proofs in ball arithmetic that periodic orbits, closed walks and connections exist; certificates and a check."""
