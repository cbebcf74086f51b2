"""The simulated bench: plant, sensors, drive, and the loop that closes them."""
