"""A scene's run settings: [run], [controller], [estimator] and [supervisor] of its file, and what overrides them.

In [run] the keys of sensors, drive and disturbances stand side by side, for a user thinks of one bench; [[run.blows]]
lists blows at given times. The same names serve as overrides: `mismatch = 0.05` in the file is `--mismatch 0.05`.
"""

from collections.abc import Mapping
from dataclasses import fields, replace
from typing import Any

from dpcontrol.control.adaptive import AdaptiveSettings
from dpcontrol.control.estimation import ESTIMATORS
from dpcontrol.control.estimator_settings import (
    AdaptiveEkfSettings,
    Augment,
    EkfSettings,
)
from dpcontrol.control.hold import HoldSettings
from dpcontrol.control.ogy import ClassicOgySettings, OgySettings
from dpcontrol.control.tracking import FeedforwardSettings, TvlqrSettings
from dpcontrol.foundation.errors import InputError
from dpcontrol.foundation.tables import Table, suggest
from dpcontrol.lab.controllers import ControllerSettings
from dpcontrol.lab.disturbances import DisturbanceSettings, Push
from dpcontrol.lab.drive import DriveSettings
from dpcontrol.lab.loop import LoopSettings
from dpcontrol.lab.programs import KEEPERS
from dpcontrol.lab.sensors import SensorSettings
from dpcontrol.lab.supervisor import SupervisorSettings

CONTROLLERS: Mapping[str, type[ControllerSettings]] = {
    "tvlqr": TvlqrSettings, "adaptive": AdaptiveSettings, "ogy": OgySettings, "ogy-classic": ClassicOgySettings,
    "lqr": HoldSettings, "feedforward": FeedforwardSettings,
}  # fmt: skip
"""Kinds of controller and what holds the settings of each."""
_PARTS: Mapping[str, type] = {"sensors": SensorSettings, "drive": DriveSettings, "disturbances": DisturbanceSettings}
_OWN = ("rate", "initial_error", "mismatch", "model_uncertainty", "travel", "seed")
_LISTS = ("explicit",)


def _part_of_name() -> dict[str, str]:
    return {f.name: part for part, kind in _PARTS.items() for f in fields(kind) if f.name not in _LISTS}


def setting_names() -> tuple[str, ...]:
    """Return the names that [run] and overrides may use."""
    return (*(name for name in _OWN if name != "seed"), *_part_of_name())


def read_run_settings(run: Table, *, controller: Table, estimator: Table, supervisor: Table) -> LoopSettings:
    """Return the settings of a scene's runs, with seed 0.

    Raises:
        InputError: an unknown key or an impossible value; names file, table, key, value and what is allowed.
    """
    blows = [table.settings(Push) for table in run.tables("blows")]
    names, values = _part_of_name(), run.remaining()
    known = setting_names()
    parts = {}
    for part, kind in _PARTS.items():
        own = {k: v for k, v in values.items() if names.get(k) == part}
        given = {"explicit": tuple(blows)} if part == "disturbances" else {}
        parts[part] = Table(own, file=run.file, name=run.name).settings(kind, also=known, **given)
    rest = Table({k: v for k, v in values.items() if k not in names}, file=run.file, name=run.name)
    keep = controller.text("keep", "none", allowed=KEEPERS)
    law = _kind(controller, CONTROLLERS, "tvlqr")
    if keep != "none" and not isinstance(law, TvlqrSettings):
        raise InputError(
            f'{controller.where("keep")} = {keep!r}: what flies between the stops is kind = "tvlqr", not "{law.kind}"'
        )
    filters = {**ESTIMATORS, "ekf": AdaptiveEkfSettings} if isinstance(law, AdaptiveSettings) else ESTIMATORS
    return rest.settings(
        LoopSettings, also=known, seed=0, keep=keep, controller=law, estimator=_kind(estimator, filters, "ekf"),
        supervisor=supervisor.settings(SupervisorSettings), **parts,
    )  # fmt: skip


def _kind(table: Table, kinds: Mapping[str, type], default: str) -> Any:
    return table.settings(kinds[table.text("kind", default, allowed=kinds)])


def overridden(loop: LoopSettings, overrides: Mapping[str, Any]) -> LoopSettings:
    """Return the settings with values replaced by name; None keeps. A controller or estimator is named by its kind.

    A controller that cannot hand over to what keeps the stops follows the whole reference itself.

    Raises:
        InputError: an unknown name or kind, or an impossible value.
    """
    names = _part_of_name()
    changes: dict[str, dict[str, Any]] = {}
    own: dict[str, Any] = {}
    for name, value in overrides.items():
        if value is None:
            continue
        if name in ("controller", "estimator"):
            kinds: Mapping[str, type] = CONTROLLERS if name == "controller" else ESTIMATORS
            if value not in kinds:
                raise InputError(f"{name} = {value!r}: {suggest(str(value), kinds)}")
            if value != getattr(loop, name).kind:
                own[name] = kinds[value]()
        elif name in _OWN or name == "keep":
            own[name] = value
        elif name == "hold":
            own["supervisor"] = replace(loop.supervisor, hold=value)
        elif name in names:
            changes.setdefault(names[name], {})[name] = value
        else:
            raise InputError(
                f"{name} = {value!r}: no such run setting; {suggest(name, (*setting_names(), 'keep', 'hold'))}"
            )
    law, filters = own.get("controller", loop.controller), own.get("estimator", loop.estimator)
    knows = Augment.PARAMETERS in filters.augments
    if isinstance(law, AdaptiveSettings) and isinstance(filters, EkfSettings) and not knows:
        # What the controller is to count on must be asked for.
        own["estimator"] = AdaptiveEkfSettings()
    elif not isinstance(law, AdaptiveSettings) and isinstance(filters, AdaptiveEkfSettings):
        own["estimator"] = EkfSettings()
    if not isinstance(law, TvlqrSettings):
        own.setdefault("keep", "none")
    own |= {part: replace(getattr(loop, part), **values) for part, values in changes.items()}
    return replace(loop, **own)
