"""Pages, pictures and films of results, drawn by matplotlib and Rerun."""
