"""Where connections appear, split or change as the energy changes."""
