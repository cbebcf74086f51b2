"""Multiple shooting of open and closed orbits.

Newton's method solves for the nodes. Orbits can be refined in 113 bits.
"""
