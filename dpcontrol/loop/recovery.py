"""What a run does after a fall: it calms the arms, starts again from rest, and goes on with the itinerary.

A run is a sequence of motions on one rig without interruption, one after the other by one `Ticker`, whose filter and
commands on their way go on:

    itinerary   the plan's reference, from some tick of it on
    return      brake, and calm the arms, from anywhere
    start       from hanging at rest to a stop of the walk, by a transfer planned beforehand; then the itinerary
"""

from collections.abc import Mapping

from dpcontrol.control.tick import BRAKING
from dpcontrol.references.problem import Limits


def calming_bounds(limits: Limits) -> Mapping[str, float]:
    """Return by what a return is judged, where it differs from a flight (`tick.BOUNDS`).

    No distance from rest is too far, and the filter may begin anew as often as it must. The law keeps the cart on its
    track; the supervisor steps in only where nothing but the hardest braking is left.
    """
    return {
        "lost_tracking": 1e9, "resynchronise": 0.0, "can_hold": 0.0, "restarts": 1e9,
        "brake": 2 * BRAKING * limits.acceleration, "margin": 0.0,
    }  # fmt: skip
