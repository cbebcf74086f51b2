"""What stands in a log before its first tick: the layout, and the arms' descriptions for viewers.

Both depend on what a tick holds, which is known from the first tick on (`layout.TickLayout`).
"""

import json
from collections.abc import Collection, Sequence
from importlib.metadata import version

from dpcontrol.logs import cdr, layout, urdf
from dpcontrol.logs.blocks import REFERENCE_PREFIX, Note

Limits = tuple[float, float, float] | None


def layout_record(
    tick: layout.TickLayout,
    arm_lengths: Sequence[float],
    *,
    rate_hz: float,
    limits: Limits,
    attachments: Collection[str],
) -> dict[str, str]:
    """Return the metadata by which a log is read: arms' lengths in m, rate in Hz, limits, parts of a tick."""
    return {
        "format": layout.FORMAT,
        "arm_lengths": " ".join(repr(length) for length in arm_lengths),
        "has_cart": "1" if tick.has_cart else "0",
        "rate_hz": repr(rate_hz),
        "limits": " ".join(repr(float(limit)) for limit in limits or ()),
        "parts": " ".join(part for part in layout.PARTS if part in tick.parts),
        "attachments": json.dumps(list(attachments)),
        "program": f"dpcontrol {version('dpcontrol')}",
    }


def descriptions(tick: layout.TickLayout, arm_lengths: Sequence[float], *, limits: Limits, time_ns: int) -> list[Note]:
    """Return the URDF of the arms, and of the reference's ghost where a tick has a reference, as messages."""
    notes: list[Note] = []
    for topic in (topic for topic in tick.channels if topic in layout.LATCHED):
        ghost = topic == layout.GHOST
        text = urdf.robot_description(
            arm_lengths,
            has_cart=tick.has_cart,
            limits=limits,
            prefix=REFERENCE_PREFIX if ghost else "",
            ghost=ghost,
        )
        notes.insert(0, Note(row=0, topic=topic, time_ns=time_ns, content=cdr.string(text)))
    return notes
