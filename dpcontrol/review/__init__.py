"""What there is to see of a run: its score, its story, and how the viewer and a page show it."""
