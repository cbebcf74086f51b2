"""Controllers and estimators that the loop runs at every tick."""
