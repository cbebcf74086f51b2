"""Existence proofs in ball arithmetic for orbits, walks and connections."""
