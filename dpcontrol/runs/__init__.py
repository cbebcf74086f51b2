"""The closed loop of a plan as one object: runs, campaigns, margins, the controller as C."""
