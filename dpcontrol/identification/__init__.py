"""Models from recordings: fit, statistics, design, replay."""
