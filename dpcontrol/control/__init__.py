"""Controllers and estimators."""
