"""Remarks on plausible values of benches: numbers of a rig that seem to be in another unit."""

from collections.abc import Iterator, Sequence

from dpcontrol.foundation.errors import InputError
from dpcontrol.foundation.settings import Settings, leaves_of
from dpcontrol.loop.loop import LoopSettings
from dpcontrol.plans.layout import BENCH, ZEROS
from dpcontrol.references.problem import Limits


def rig_oddities(
    limits: Limits, loop: LoopSettings, *, arms: int, zeros: Sequence[float] = ()
) -> Iterator[tuple[str, str, str]]:
    """Yield the table, the key and a sentence on each unusual number of a rig.

    Args:
        limits: the cart's limits.
        loop: settings of the run.
        arms: number n of arms.
        zeros: readings (n,) of the hanging arms, rad, or none.

    Raises:
        InputError: an impossible number, or one that needs other arms.
    """
    try:
        _check_arms(loop, arms)
    except InputError as error:
        raise error.under("[run] ") from error
    parts: list[tuple[str, Settings]] = [("[limits]", limits), ("[run]", loop)]
    parts += [("[run]", getattr(loop, name)) for name in BENCH]
    parts += [("[supervisor]", loop.supervisor), ("[estimator]", loop.estimator)]
    parts += [("[[run.blows]]", blow) for blow in loop.disturbances.explicit]
    leaves = [
        (table, leaf, getattr(part, leaf.name)) for table, part in parts for leaf in leaves_of(type(part)).values()
    ]
    for table, leaf, value in [*leaves, ("[run]", ZEROS, zeros)]:
        try:
            for sentence in leaf.bounds.oddities(leaf.name, value) if value is not leaf.default else ():
                yield table, leaf.name, sentence
        except InputError as error:
            raise error.under(f"{table} ") from error


def _check_arms(loop: LoopSettings, arms: int) -> None:
    """Reject settings that have a value for each arm or name an arm if they do not fit the number of arms.

    Raises:
        InputError: names the first such setting.
    """
    if loop.sensors.stuck_sensor > arms:
        raise loop.sensors.refusal(
            "stuck_sensor", f"must be 0 to {arms}: 0 is the encoder of the inner arm, {arms} the cart's"
        )
    for number, blow in enumerate(loop.disturbances.explicit, start=1):
        if blow.arm >= arms:
            raise InputError(f"blow {number}, arm = {blow.arm}: must be 0 to {arms - 1}, 0 for the inner arm")
    loop.sensors.of_each("counts", arms)
    if not any(loop.of_each("encoders", arms)):
        raise loop.refusal("encoders", "the cart alone does not show the arms; at least one arm must be measured")
    for name in ("play", "known_play", "stiction", "initial_rate"):
        loop.mechanics.of_each(name, arms)
