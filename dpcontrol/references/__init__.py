"""References: feasible motions of the bench from direct collocation, with friction, the cart and its limits."""
