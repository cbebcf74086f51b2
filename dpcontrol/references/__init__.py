"""References: what the bench shall do, from direct collocation with friction, cart and limits."""
