"""The simulated bench: plant, sensors, drive, loop."""
