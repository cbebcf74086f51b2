"""Score and story of a run, drawn in the viewer and on a page."""
