"""Short scripts in the notebook style, each of which ends in a picture: `python -m dpcontrol.examples.orbit`."""
