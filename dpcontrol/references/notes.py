"""What a plan says beyond its reference's trajectory: JSON that is kept with it, by the types of its entries.

Arrays that go with it stand among the reference's `extra`: `orbit_K` (M, 2n), samples of the K-th orbit over a period.
"""

from typing import Any, Literal, NotRequired, TypedDict, cast

from dpcontrol.references.reference import Reference


class StopNote(TypedDict):
    """Where the pendulum wobbles or rests: its angles with all their turns, rad; indices into `orbits`.

    arrived_on: the orbit it came on, where the energy is changed at the stop.
    """

    saddle: str
    angles: list[float]
    orbit: int
    arrived_on: NotRequired[int]


class SectionNote(TypedDict):
    """Where a connection crosses its section: normal · state = value, at these angles, rad."""

    normal: list[float]
    value: float
    angles: list[float]


class SymbolNote(TypedDict):
    """What leads from one stop to the next: a connection, or a transfer, whose name and section are None.

    time s: of the section's crossing, or the middle of a transfer; time_out, time_in s: from the orbit to the section
    and on to the next orbit, at their phases; null of a transfer.
    """

    text: str
    name: str | None
    source: str
    target: str
    winding: list[int]
    sense: int
    time: float
    section: SectionNote | None
    time_out: float
    time_in: float
    phase_out: float
    phase_in: float


class OrbitNote(TypedDict):
    """A periodic orbit, or an equilibrium, whose period is how long its ends are looked at: J, s."""

    saddle: str
    energy: float
    period: float
    multiplier: float


class SaddleNote(TypedDict):
    """An equilibrium at its named position: rad, J."""

    angles: list[float]
    energy: float


class ShadowingNote(TypedDict):
    """How the walks' orbits were found: the largest residual, None where there is no walk; s together."""

    residual: float | None
    duration: float
    status: str
    wraps_realised: list[int]


class OriginNote(TypedDict):
    """What makes the plan again: the texts of scene and model with their hashes, the arms, the program."""

    program: str
    scene: str
    scene_hash: str
    model: str
    model_hash: str
    parameters: dict[str, Any]
    code: NotRequired[str]


class StayNote(TypedDict):
    """Of an itinerary that goes nowhere: the equilibrium held, or the orbit kept and what finds it again."""

    kind: Literal["hold", "orbit"]
    hold: NotRequired[str]
    orbit: NotRequired[str]
    energy: NotRequired[float]
    family: NotRequired[int]
    intervals: NotRequired[int]
    lyapunov_period: NotRequired[float]


class SegmentNote(TypedDict):
    """A stay ("keep", the saddle) or a flight ("fly") of a walk whose stops are kept.

    rows: intervals of the mesh from the first to before the second, of a stay those of its first period; turns: by
    which its states are away from the orbit's own.
    """

    rows: list[int]
    fly: NotRequired[str]
    keep: NotRequired[str]
    energy: NotRequired[float]
    family: NotRequired[int]
    lyapunov_period: NotRequired[float]
    turns: NotRequired[list[float]]
    periods: NotRequired[int]


class PlanNotes(TypedDict):
    """All of a plan's notes. wraps: one for each interior stop, None beside a transfer, where they are not counted;
    transfers: s between which the pendulum is on its way from piece to piece; energy J: of the first orbit.
    """

    itinerary: str
    title: str
    model: str
    energy: float | None
    walk: list[str]
    wraps: list[int | None]
    lead_in: int | None
    lead_out: int | None
    shadowing: ShadowingNote
    stops: list[StopNote]
    symbols: list[SymbolNote]
    transfers: list[list[float]]
    orbits: list[OrbitNote]
    saddles: dict[str, SaddleNote]
    made_from: OriginNote
    plan: NotRequired[str]
    stay: NotRequired[StayNote]
    program: NotRequired[list[SegmentNote]]


def plan_notes(reference: Reference) -> PlanNotes:
    """Return the notes of a reference that a plan made."""
    return cast(PlanNotes, dict(reference.notes))
