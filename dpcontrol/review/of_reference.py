"""What a review of a reference needs, from its file alone."""

import json
import zipfile
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from dpcontrol.dynamics.chain import pendulum_system
from dpcontrol.foundation.errors import InputError
from dpcontrol.references.reference import FORMAT, load_reference
from dpcontrol.references.summary import ReferenceSummary, summarised
from dpcontrol.review.context import ReviewContext
from dpcontrol.review.motion import Motion, motion_of_reference
from dpcontrol.review.of_log import plan_context


@dataclass(frozen=True, eq=False)
class ReferenceReview:
    """A reference as a motion, with what its plan says, and the summary that its page shows."""

    summary: ReferenceSummary
    motion: Motion
    context: ReviewContext


def is_reference(file: Path) -> bool:
    """Tell by its header whether a file is a reference; what cannot be read is none."""
    try:
        with np.load(file, allow_pickle=False) as content:
            return json.loads(str(content["header"]))["format"] == FORMAT
    except (OSError, ValueError, KeyError, TypeError, EOFError, zipfile.BadZipFile):
        return False


def reference_review(file: Path) -> ReferenceReview:
    """Return a reference for review; its error between nodes is measured anew.

    Raises:
        InputError: the file is no reference, or its notes are not those of a plan.
    """
    reference = load_reference(file)
    try:
        summary = summarised(reference)
        system = None if summary.arms is None else pendulum_system("model", summary.arms)
        context = plan_context(reference, system=system)
    except InputError as error:
        raise InputError(f"{file}: {error}") from error
    motion = motion_of_reference(reference, Path(file), arm_lengths=context.arm_lengths)
    effort = f"{reference.duration:.4g} s, {reference.rms_cart_acceleration:.3g} m/s² rms"
    good = None if reference.converged else False
    context = replace(
        context, energy=summary.energies(motion.state), verdict=f"{reference.status}; {effort}", good=good
    )
    return ReferenceReview(summary, motion, context)
