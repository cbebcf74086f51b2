"""Models from recordings: fits, their statistics, experiment design and replay."""
