"""References: feasible motions of the bench from direct collocation with friction, cart and limits."""
