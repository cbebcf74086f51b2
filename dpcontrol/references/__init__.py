"""References: feasible motions of the bench from direct collocation.

They have friction, the cart and its limits.
"""
