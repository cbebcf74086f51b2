"""From an itinerary to its reference by connections, shadowing orbit and collocation, cached by content.

Symbols, stops and orbits are stored with the reference (`dpcontrol.references.content`). So a log that contains the
reference can be scored and reviewed without other files.
"""

import json
import os
from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from functools import cached_property
from io import BytesIO
from itertools import pairwise
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar

from dpcontrol.foundation.arrays import Array
from dpcontrol.foundation.cache import cache_file, keep, kept
from dpcontrol.foundation.causes import ReferenceCause
from dpcontrol.foundation.checked import checked
from dpcontrol.foundation.document import Documented
from dpcontrol.foundation.errors import GoalMissed
from dpcontrol.foundation.files import content_hash, write_whole
from dpcontrol.foundation.progress import Cost, Progress, announce, no_progress
from dpcontrol.foundation.shown import Timed, checked_times
from dpcontrol.logs.layout import state_names
from dpcontrol.plans.cautions import Caution, cautions_of
from dpcontrol.plans.itinerary import HoldPart, Itinerary, WalkPart, stored_itinerary
from dpcontrol.references.content import PlanContent
from dpcontrol.references.ending import ReferenceEnding
from dpcontrol.references.problem import PLANNING
from dpcontrol.references.reference import ByReference, Reference, load_reference, save_reference

if TYPE_CHECKING:
    from dpcontrol.walks.shadowing import ShadowingOrbit

FORMAT = 4
"""Version of the content, raised whenever its meaning changes."""


@dataclass(frozen=True)
class Plan(ByReference, Timed, Documented):
    """An itinerary's reference with its content.

    There is no file if the reference did not converge, or the cache is not writable.

    Attributes:
        itinerary: itinerary of the plan.
        reference: motion that the loop follows.
        file: requested file, otherwise the one in the cache.
        cached: True if the plan was in the cache.
        polished: `Polished` plan of one optimisation problem, if requested.
        margins: margins of gain, delay and lag, if requested.
        energies: chart of the effort over energies, if requested.
    """

    KEYS: ClassVar[str] = (
        "walk=content.walk wraps=content.wraps shadowing=content.shadowing transfers=content.costs "
        "reference:intervals,duration,max_error_between_nodes,constraint_violation,max_cart_position,max_cart_velocity,max_cart_acceleration,"
        "rms_cart_acceleration,iterations,solve_seconds,status file=written cached status "
        "warnings polish?=polished margins? energies?"
    )

    itinerary: Itinerary
    reference: Reference
    file: Path
    cached: bool
    polished: Any = None
    margins: Any = None
    energies: Any = None

    def __repr__(self) -> str:
        return f"<plan {self.itinerary.name!r}: {self.status}>"

    @property
    def final(self) -> "Plan":
        """The polished plan if one was requested, otherwise this one."""
        return self if self.polished is None else self.polished.polished

    @cached_property
    def warnings(self) -> tuple[Caution, ...]:
        """Properties that make its runs likely to fail, confirmed by simulated runs."""
        return cautions_of(self.itinerary, self.reference) if self.converged else ()

    @property
    def missed(self) -> str:
        """Reason for the lack of a final plan, or ""."""
        return "" if self.final.converged else f"{self.itinerary.name}: {self.final.status}"

    @checked
    def written_to(self, file: Path) -> "Plan":
        """Write the final plan to a file, and return this one with its name.

        Args:
            file: reference to write (.npz).
        """
        write_whole(file, self.final.archive)
        if self.polished is None:
            return replace(self, file=file)
        return replace(self, polished=replace(self.polished, polished=replace(self.final, file=file)))

    @property
    def time_range(self) -> tuple[float, float]:
        """First and last time, s."""
        return float(self.reference.mesh[0]), float(self.reference.mesh[-1])

    @property
    def columns(self) -> tuple[str, ...]:
        """Names of the N entries of a state."""
        return state_names(self.itinerary.model.arms.count, has_cart=True)

    def states(self, times: Any = None) -> Array:
        """Return the states of arms and cart at given times.

        Args:
            times: times (K,) from the start, s (default: 200 over the whole plan). Times outside count as the nearest
                end.

        Returns:
            States (K, N): angles, rates, and the cart's position and velocity.

        Raises:
            InputError: the times are not finite numbers.
        """
        return self.sample() if times is None else self.reference.state(checked_times(times))

    @property
    def content(self) -> PlanContent:
        """Symbols, stops and orbits of the plan."""
        return self.reference.content

    @cached_property
    def archive(self) -> bytes:
        """The reference as the bytes of its .npz file."""
        file = BytesIO()
        save_reference(file, self.reference)
        return file.getvalue()

    def followed(self) -> "Plan":
        """Return the plan itself if its reference can be followed, for callers that need one.

        Raises:
            GoalMissed: it did not converge.
        """
        if not self.converged:
            raise GoalMissed(f"{self.itinerary.name} has no reference to follow: {self.status}")
        return self

    @property
    def written(self) -> Path | None:
        """The file if the reference converged and was written."""
        return self.file if self.converged and os.path.isfile(self.file) else None


def plan_key(itinerary: Itinerary) -> str:
    """Return the hash of a plan's inputs (16 hexadecimal digits), which is its key in the cache.

    Args:
        itinerary: itinerary of the plan.
    """
    content = {
        "format": FORMAT,
        "code": PLANNING,
        "parameters": asdict(itinerary.model.arms),
        "name": itinerary.name,
        "title": itinerary.title,
        "model": itinerary.model.name,
        "parts": [asdict(part) for part in itinerary.parts],
        "ends": (itinerary.start, itinerary.finish),
        "transfer": itinerary.transfer,
        "limits": asdict(itinerary.limits),
        "reference": asdict(itinerary.reference),
        "keeps": itinerary.keeps,
    }
    return content_hash(json.dumps(content, sort_keys=True))


_SECONDS, _MEMORY = 0.25, 3.5e6
"""Planning cost of each period of a walk, in s and bytes, measured over 200 periods."""
_FLIGHT = 4
"""Periods per symbol."""
_TRANSFER, _TRANSFER_OF_MORE = 1.6, 6.0
"""Planning time of a transfer of one or two arms, and of more, s."""


def _amounts(itinerary: Itinerary) -> dict[str, int]:
    """Return the numbers by which planning becomes long, by the keys of an itinerary's file that set them."""
    return {
        "wraps": sum(itinerary.wraps),
        "walk": len(itinerary.walk),
        "lead_in": sum(part.lead_in for part in itinerary.walks),
        "lead_out": sum(part.lead_out for part in itinerary.walks),
    }


def _extent(itinerary: Itinerary) -> tuple[int, int]:
    """Return the numbers of periods and of transfers in an itinerary, from which the cost of planning follows."""
    ends = zip((itinerary.start, itinerary.finish), (itinerary.parts[0], itinerary.parts[-1]), strict=True)
    transfers_at_ends = (end == "rest" or (end == "hold" and isinstance(part, WalkPart)) for end, part in ends)
    transfers_between = (any(isinstance(part, HoldPart) for part in pair) for pair in pairwise(itinerary.parts))
    amounts = _amounts(itinerary)
    return sum(amounts.values()) + (_FLIGHT - 1) * amounts["walk"], sum(transfers_at_ends) + sum(transfers_between)


def plan_cost(itinerary: Itinerary) -> Cost:
    """Return the cost of planning an itinerary, without the small cost of stays.

    Args:
        itinerary: itinerary to plan.
    """
    periods, transfers = _extent(itinerary)
    walk_seconds = _SECONDS * periods
    transfer_seconds = (_TRANSFER if itinerary.model.arms.count < 3 else _TRANSFER_OF_MORE) * transfers
    # The user is told the key of the file that makes planning long.
    key, amount = max(_amounts(itinerary).items(), key=lambda item: item[1])
    if transfer_seconds > walk_seconds:
        key, amount = "parts", len(itinerary.parts)
    cause = f"{itinerary.path}: {key}, {amount:,} {'symbols' if key == 'walk' else 'in all'}"
    work = f"a reference of {periods:,} periods" + (f" and {transfers:,} transfers" if transfers else "")
    return Cost(work, walk_seconds + transfer_seconds, _MEMORY * (periods + _FLIGHT * transfers), cause)


_PERIOD, _TRANSFER_LASTS = 0.7, 2.5
"""Approximate durations of an orbit and of a transfer of the lab's arms, s."""


def expected_seconds(itinerary: Itinerary) -> float:
    """Estimate the duration (s) of an itinerary's motion before it is planned.

    Args:
        itinerary: itinerary to plan.
    """
    periods, transfers = _extent(itinerary)
    stays = sum(part.seconds for part in itinerary.parts if not isinstance(part, WalkPart))
    return _PERIOD * periods + _TRANSFER_LASTS * transfers + stays


def make_plan(
    itinerary: Itinerary,
    *,
    orbits: "Sequence[ShadowingOrbit]" = (),
    progress: Progress = no_progress,
    fresh: bool = False,
    workers: int = 1,
    yes: bool = False,
) -> Plan:
    """Return the plan of an itinerary, from the cache if possible.

    A reference that did not converge is returned with its status and not cached.

    Args:
        itinerary: itinerary to plan.
        orbits: shadowing orbits of its walks, if known.
        progress: receiver of progress reports.
        fresh: ignore the cache.
        workers: processes that search for transfers, 0 for a useful number.
        yes: accept any duration.

    Raises:
        InputError: the walk needs connections that do not exist at this energy, or the plan would take too long.
        GoalMissed: an orbit or the shadowing orbit did not converge.
    """
    if itinerary.stored is not None and not fresh:
        return replace(load_plan(itinerary.stored), itinerary=itinerary)
    file = cache_file("plans", itinerary.name, plan_key(itinerary))
    if not fresh and (content := kept(file)) is not None:
        return _cached(itinerary, content, file)
    announce(plan_cost(itinerary), yes=yes)
    # A cached plan does not need the planner.
    from dpcontrol.judge.decoding import shortfall
    from dpcontrol.plans.planning import planned

    reference = planned(itinerary, orbits, fresh=fresh, workers=workers, progress=progress)
    reference = replace(reference, plan=replace(reference.content, key=plan_key(itinerary)))
    if reference.converged and (missed := shortfall(reference)):
        reference = replace(reference, converged=False, ending=ReferenceEnding(ReferenceCause.SHORTFALL, inner=missed))
    plan = Plan(itinerary, reference, file, cached=False)
    if plan.converged:
        keep(file, plan.archive)
    return plan


def _cached(itinerary: Itinerary, content: bytes, file: Path) -> Plan:
    """Return a cached plan with the texts of this itinerary.

    The cache's key has the inputs of planning alone, so settings of runs and the plant may have changed.

    Args:
        itinerary: requested itinerary.
        content: bytes of the cached .npz file.
        file: the cached file.
    """
    reference = load_reference(BytesIO(content))
    plan = reference.content
    origin = replace(plan.origin, scene=itinerary.text, scene_hash=content_hash(itinerary.text), plant=itinerary.plant)
    return Plan(itinerary, replace(reference, plan=replace(plan, origin=origin)), file, cached=True)


def load_plan(file: Path) -> Plan:
    """Read a plan from its archive, with the itinerary of the stored texts.

    Args:
        file: file of the plan (.npz).

    Raises:
        InputError: the file is missing, damaged, or a reference without a plan.
    """
    reference = load_reference(file)
    return Plan(stored_itinerary(file, reference), reference, file, cached=True)
