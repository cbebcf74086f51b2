"""References: feasible motions of the bench from direct collocation, with friction, the cart and its limits.

References: feasible motions of the bench from direct collocation.

They have friction, the cart and its limits.
"""
