"""Direct collocation: references a bench can follow."""
