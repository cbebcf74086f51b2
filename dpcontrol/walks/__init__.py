"""Walks over connections and the orbits that shadow them."""
