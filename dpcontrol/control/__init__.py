"""Controllers and estimators: what the loop asks at every tick."""
