"""Score, Rerun recording and pictures of a log."""
