"""Learn a rig's arms from its runs, and plan again for these arms.

A run with the adaptive law ends with estimates e of the constant errors of its model, and their covariance P. In the
logarithms y of the identifiable inertial ratios, and in the friction over C, they are linear:

    y = y₀ + J e,    Y = J P Jᵀ,    and before the run  y₀,  Y₀ = J P₀ Jᵀ

The readings of a run add the information Y⁻¹ - Y₀⁻¹ to what was assumed before it. Those of several runs are added to
what the first of them assumed, so a run that began at the result of another counts that one's readings once:

    I = Y₀₁⁻¹ + Σ (Y_j⁻¹ - Y₀_j⁻¹),    I y = Y₀₁⁻¹ y₀₁ + Σ (Y_j⁻¹ y_j - Y₀_j⁻¹ y₀_j)

The filter trusts its equations. If the plant has friction of another kind, the NIS exceeds the expected one by a share
s, and the resulting error does not average out over the K ticks of a run. So the readings of such a run leave 1 + K s
times the variance: the excess counts as one sample.

Dry friction is part of the learnt model if it exceeds three standard errors. Otherwise the rest is conditioned on none.

The arms are the nearest to the model's with these ratios (`nearest_arms`). An energy of the itinerary keeps its height
above the highest equilibrium below it, as a share of that from hanging to upright. If a connection of the walk does not
exist there, more energy is tried. Transfers start from those of the last plan; walks are planned afresh.

Source: Bar-Shalom, Li & Kirubarajan, Estimation with Applications to Tracking and Navigation, sections 3.4 and 8.3.
White, Maximum likelihood estimation of misspecified models (1982), for readings that contradict the model.
"""

import json
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import ClassVar

import numpy as np

from dpcontrol.control.estimator_settings import nis_means
from dpcontrol.dynamics.chain import (
    ArmChainParameters,
    Friction,
    base_ratios,
    inertial_count,
    nearest_arms,
    ratio_names,
    with_laws,
)
from dpcontrol.foundation.arrays import Array
from dpcontrol.foundation.document import Documented
from dpcontrol.foundation.errors import GoalMissed, InputError
from dpcontrol.foundation.files import write_whole
from dpcontrol.foundation.progress import Progress, no_progress, part_of
from dpcontrol.foundation.toml import parse_toml, with_values
from dpcontrol.judge.decoding import stays
from dpcontrol.judge.score import CONSTANTS_METADATA, MODEL_METADATA, arms_in
from dpcontrol.logs import RunLog
from dpcontrol.loop.assembly import Assembly
from dpcontrol.loop.result import rms, sensors_of
from dpcontrol.orbits.lyapunov import equilibria
from dpcontrol.plans.itinerary import Itinerary, itinerary_from
from dpcontrol.plans.layout import HoldPart
from dpcontrol.plans.model import Model, learnt_text, model_from
from dpcontrol.plans.plan import Plan, make_plan
from dpcontrol.references.find import tail

SETTLED = 1.0
"""Time after which the effort of the feedback counts, s: before, it removes the errors of the start."""
_SIGNIFICANT = 3.0
"""Standard errors from which dry friction is part of the model."""
RAISED = (1.0, 1.6, 2.5)
"""Factors on the energies' heights above the saddles that are tried in turn."""


@dataclass(frozen=True, eq=False)
class Learnt(Documented):
    """Arms learnt from runs, with the plan for them.

    Attributes:
        names, values, errors: ratios of the arms (m,) by `ratio_names`, and their standard errors, SI units.
        model: model of the arms, with the covariance of the ratios.
        plan: plan of the last run's itinerary for these arms, with a filter that starts at the learnt covariance.
        effort_before: feedback beyond the feedforward in the last run, m/s² rms after its first second.
        effort_expected: the same in a simulated run of the new plan, with a plant drawn from the covariance.
        file: file of the model, None if it was not written.
    """

    KEYS: ClassVar[str] = (
        "means=rows:name,value,sigma effort_before effort_expected model=model.name file plan=plan.written "
        "status=plan.status"
    )

    names: tuple[str, ...]
    values: Array
    errors: Array
    model: Model
    plan: Plan
    effort_before: float
    effort_expected: float
    file: Path | None = None

    def written_to(self, file: Path) -> "Learnt":
        """Write the model, and its plan beside it, and return this result with their names.

        Args:
            file: model to write (.toml).
        """
        write_whole(file, self.model.text)
        return replace(self, file=file, plan=self.plan.written_to(file.with_suffix(".npz")))

    @property
    def rows(self) -> list[tuple[str, float, float]]:
        """Name, value and standard error of each ratio."""
        return [*zip(self.names, self.values.tolist(), self.errors.tolist(), strict=True)]


def coordinates(arms: ArmChainParameters, names: Sequence[str]) -> tuple[Array, Array]:
    """Return the coordinates y₀ (m,) of a model, and their derivatives J (m, C) by the errors that a filter estimates.

    Coordinates are the logarithms of the identifiable inertial ratios, then the friction ratios. In them, the filter's
    relative errors of parameters act linearly, so its estimates and covariances can be converted.

    Args:
        arms: parameters of the model.
        names: names of the model's constant errors (C,), which are the same in each run, see
            `estimator_settings.constants`.
    """
    arms = with_laws(arms, (Friction.COULOMB,))
    labels, count = [name.partition("/")[0].replace("G", "S") for name in ratio_names(arms)], inertial_count(arms.count)
    ratio_of = dict(zip(labels, base_ratios(arms), strict=True))
    effects = {(label, label): 1.0 for label in labels[:count]}
    for i in range(1, arms.count + 1):
        # The length of an inner arm is the ratio of a coupling M to a weight S.
        effects |= {(f"l{i}", f"M{i}{i + 1}"): 1.0, (f"l{i}", f"S{i + 1}"): -1.0}
        # Errors of friction are relative to the model's; additional dry friction is relative to the weight.
        effects |= {(f"{law}_{i}", f"friction_{i}"): ratio_of[f"{law}_{i}"] for law in ("viscous", "coulomb")}
        effects[f"coulomb_{i}", f"dry_{i}"] = ratio_of[f"S{i}"]
    jacobian = np.array([[effects.get((label, name), 0.0) for name in names] for label in labels])
    values = [*ratio_of.values()]
    return np.concatenate([np.log(values[:count]), values[count:]]), jacobian


Estimate = tuple[Array, Array]
"""Coordinates (m,) and their covariance (m, m). Those without variance, as of missing friction, are known."""


def evidence(log: RunLog) -> tuple[list[str], Estimate, Estimate]:
    """Return the names of a filter's constant errors, and its estimates of the model before and after a run.

    Both estimates are coordinates with their covariance. Their difference in information (inverse covariance) is that
    of the run's readings.

    Args:
        log: log of the run.

    Raises:
        InputError: the log has no estimates of its model's errors.
    """
    errors_text, arms = log.metadata.get(CONSTANTS_METADATA), arms_in(log, MODEL_METADATA)
    if errors_text is None or arms is None:
        raise InputError(
            f"{log.path} has no errors of the model to learn from: they are in whole logs of this version of runs "
            'with controller = "adaptive" and estimator = "ekf"'
        )
    names, errors, *covariances = json.loads(errors_text)
    model_coordinates, jacobian = coordinates(arms, names)
    covariance_after, covariance_before = (jacobian @ covariance @ jacobian.T for covariance in covariances)
    return names, (model_coordinates, covariance_before), (model_coordinates + jacobian @ errors, covariance_after)


def caution(log: RunLog) -> float:
    """Return the factor on the variance that the readings of a run leave, 1 or more.

    It exceeds 1 if the NIS shows that the plant contradicts the filter's equations.

    Args:
        log: log of the run.
    """
    nis = nis_means(log.control["nis"], sensors_of(log.measured))
    return 1.0 if nis is None else 1.0 + len(log.time) * max(nis.mean / nis.expected - 1.0, 0.0)


def combined(before: Sequence[Estimate], after: Sequence[Estimate], cautions: Sequence[float]) -> Estimate:
    """Return the estimate from several runs, weighted by information (inverse covariances).

    The assumption of a run that began at the result of another one must not count twice. So each run adds the result of
    its filter, and subtracts its own assumption. Coordinates without a variance are those of the last run.

    Args:
        before: estimate that each run assumed, coordinates (m,) and covariance (m, m).
        after: estimate after each run.
        cautions: factor on the variance that its readings leave, see `caution`.
    """
    values, covariance = (array.copy() for array in after[-1])
    free_rows = np.flatnonzero(covariance.diagonal() > 0)
    free_block, weights = np.ix_(free_rows, free_rows), 1 / np.array(cautions)
    weighted_runs = [(before[0], 1.0), *zip(after, weights, strict=True), *zip(before, -weights, strict=True)]
    information_and_means = [
        (weight * np.linalg.inv(run[1][free_block]), run[0][free_rows]) for run, weight in weighted_runs
    ]
    covariance[free_block] = np.linalg.inv(np.sum([information for information, _ in information_and_means], axis=0))
    values[free_rows] = covariance[free_block] @ np.sum(
        [information @ means for information, means in information_and_means], axis=0
    )
    return values, covariance


def learnt_arms(
    values: Array, covariance: Array, start: ArmChainParameters, names: Sequence[str]
) -> tuple[ArmChainParameters, Array, Array]:
    """Return the arms whose ratios are nearest to learnt coordinates, for a new model, with two covariances.

    The covariance (f, f) is that of the arms' ratios, (C, C) that of the constant errors of a filter with these arms.
    Coordinates are the logarithms of inertial ratios, then the ratios of viscous and of dry friction, n each. Dry
    friction that the old model lacks is only added if it is significant (`_SIGNIFICANT` standard errors).

    Args:
        values: learnt coordinates (m,), see `coordinates`.
        covariance: their covariance (m, m).
        start: parameters of the old model, whose arms are the first guess.
        names: names of its constant errors (C,).

    Raises:
        GoalMissed: there are no such arms near the model's.
    """
    n, inertial = start.count, inertial_count(start.count)
    viscous_rows, dry_rows = (np.arange(first, first + n) for first in (inertial, inertial + n))
    insignificant = dry_rows[
        (values[dry_rows] <= _SIGNIFICANT * np.sqrt(covariance[dry_rows, dry_rows])) & (not start.coulomb)
    ]
    # Friction that is not significant is left out: the other values are conditioned on none.
    values = (
        values
        - covariance[:, insignificant]
        @ np.linalg.pinv(covariance[np.ix_(insignificant, insignificant)])
        @ values[insignificant]
    )
    laws = tuple(law for law in Friction if getattr(start, law) or (law is Friction.COULOMB and insignificant.size < n))
    # Drag of the air is estimated together with viscous friction.
    drag_ratios = np.divide(
        start.quadratic or np.zeros(n), start.viscous, out=np.zeros(n), where=np.array(start.viscous) > 0
    )
    slopes_by_law = {
        Friction.COULOMB: np.eye(len(values))[dry_rows],
        Friction.QUADRATIC: drag_ratios[:, None] * np.eye(len(values))[viscous_rows],
    }
    scale = np.append(np.exp(values[:inertial]), np.ones(2 * n))
    ratio_jacobian = np.concatenate([np.diag(scale)[: inertial + n], *(slopes_by_law[law] for law in laws)])
    ratios = ratio_jacobian @ np.append(np.ones(inertial), values[inertial:])
    arms = nearest_arms(ratios, with_laws(start, laws))
    error_jacobian = np.linalg.pinv(coordinates(arms, names)[1])
    return arms, ratio_jacobian @ covariance @ ratio_jacobian.T, error_jacobian @ covariance @ error_jacobian.T


def of_learnt_arms(itinerary: Itinerary, model: Model, errors: Array, *, raised: float = 1.0) -> Itinerary:
    """Return the itinerary of the same motion for learnt arms, whose filter starts at the learnt covariance.

    Each energy keeps its height above the saddle below it, as a share of the energy from hanging to upright.

    Args:
        itinerary: itinerary of the runs.
        model: model of the learnt arms.
        errors: covariance (C, C) of the model's constant errors.
        raised: factor on the energies' heights above the saddles.
    """
    text, has_parts = itinerary.text, "parts" in parse_toml(itinerary.text, itinerary.name)
    systems = (itinerary.model.system, model.system)
    old_equilibria, new_equilibria = map(equilibria, systems)
    scale = systems[1].energy_scale / systems[0].energy_scale
    for number, part in enumerate(itinerary.parts, start=1):
        if not isinstance(part, HoldPart):
            lower_equilibria = [name for name, point in old_equilibria.items() if point.energy < part.energy]
            old_saddle_energy, new_saddle_energy = (
                max(points[name].energy for name in lower_equilibria) for points in (old_equilibria, new_equilibria)
            )
            energy = new_saddle_energy + raised * scale * (part.energy - old_saddle_energy)
            text = with_values(text, "parts" if has_parts else "", {"energy": energy}, number=number * has_parts)
    covariance = tuple(errors.ravel().tolist())
    text = with_values(with_values(text, "", {"model": model.name}), "estimator", {"learnt": covariance})
    loop = itinerary.loop.with_({"estimator.learnt": covariance})
    return replace(itinerary_from(text, itinerary.name, model, plant=itinerary.plant), loop=loop)


def replanned(plan: Plan, model: Model, errors: Array, *, progress: Progress = no_progress) -> Plan:
    """Return the plan of the same motion for learnt arms, at the first of the raised energies that has one.

    The arms' connections differ, so one that existed for the old model may not exist at the same height.

    Args:
        plan: plan of the runs.
        model: model of the learnt arms.
        errors: covariance (C, C) of the model's constant errors.
        progress: receiver of progress reports.

    Raises:
        GoalMissed: there is none at any of the energies.
    """
    reasons: list[str] = []
    costs, no_turns = plan.content.costs, np.zeros(0)
    last_transfers = tuple(tail(plan.reference, cost.begin, seconds=cost.duration, turns=no_turns) for cost in costs)
    for raised in RAISED:
        itinerary = of_learnt_arms(plan.itinerary, model, errors, raised=raised)
        try:
            new_plan = make_plan(replace(itinerary, near=last_transfers), progress=progress).followed()
            return replace(new_plan, itinerary=itinerary)
        except (GoalMissed, InputError) as error:
            reasons.append(str(error))
    raise GoalMissed(f"{plan.itinerary.name} has no plan for the learnt arms: {reasons[0]}")


def effort(times: Array, feedback: Array) -> float:
    """Return the feedback beyond the feedforward as m/s² rms, which measures how well the model fits.

    It counts after the first second; for a shorter run, its last row counts.

    Args:
        times: times (K,), s.
        feedback: feedback (K,), m/s².
    """
    return rms(feedback[times >= min(times[0] + SETTLED, times[-1])])


def learn(logs: Sequence[RunLog], plan: Plan, *, progress: Progress = no_progress) -> Learnt:
    """Learn the arms from runs and plan an itinerary again.

    Args:
        logs: logs of runs on one rig, in order.
        plan: plan of the last run, its itinerary with the settings of the run.
        progress: receiver of progress reports.

    Raises:
        InputError: a log has no estimates of the model's errors, or the runs estimated different ones.
        GoalMissed: there are no arms near the model's with the learnt ratios, or no plan for them.
    """
    last_itinerary = plan.itinerary
    names, before, after = zip(*map(evidence, logs), strict=True)
    if any(run_names != names[-1] for run_names in names):
        raise InputError(f"{logs[0].path} and {logs[-1].path} have different arms or estimated different errors")
    values, covariance = combined(before, after, [*map(caution, logs)])
    arms, ratios, errors = learnt_arms(values, covariance, last_itinerary.model.arms, names[-1])
    text = learnt_text(last_itinerary.model, arms, ratios, [log.path.name for log in logs])
    model = model_from(text, f"{last_itinerary.name}-learnt")
    plan = replanned(plan, model, errors, progress=part_of(progress, 0.0, 0.8))
    loop = replace(plan.itinerary.loop, plant=None, mismatch=0.0, friction=1.0, model_uncertainty=1.0)
    simulated_run = Assembly(plan.reference, arms, loop, model.uncertainty, stays=stays(plan.reference)).simulate()
    # Column 2 of `control` is the feedback, m/s².
    return Learnt(
        ratio_names(arms),
        base_ratios(arms),
        np.sqrt(ratios.diagonal()),
        model,
        plan,
        effort(logs[-1].time, logs[-1].control["feedback"]),
        effort(simulated_run.ticks.times, simulated_run.ticks.control[:, 2]),
    )
