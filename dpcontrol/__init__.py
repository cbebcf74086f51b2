"""Trajectory design and control for a laboratory double pendulum on a cart.

`import dpcontrol as dp` offers the functions of `dpcontrol.api`, each loaded when it is first used.
"""

TYPE_CHECKING = False  # typing's own takes as long to import as all of this
if TYPE_CHECKING:
    from dpcontrol.api import (
        GoalMissed,
        InputError,
        Limits,
        Model,
        ReferenceSettings,
        RunOptions,
        Section,
        Sizes,
        SymbolicLaw,
        SymbolicPlant,
        System,
        Terms,
        atlas,
        cache,
        campaign,
        closed_loop,
        connections,
        export,
        find_bifurcations,
        graph,
        identify,
        load_model,
        mjcf,
        open_atlas,
        open_log,
        open_plan,
        open_planner,
        open_recording,
        orbit,
        picture,
        plan,
        prove,
        reference,
        run,
        shadow,
        swings,
    )

__version__ = "0.2.0"
__all__ = [
    "GoalMissed",
    "InputError",
    "Limits",
    "Model",
    "ReferenceSettings",
    "RunOptions",
    "Section",
    "Sizes",
    "SymbolicLaw",
    "SymbolicPlant",
    "System",
    "Terms",
    "atlas",
    "cache",
    "campaign",
    "closed_loop",
    "connections",
    "export",
    "find_bifurcations",
    "graph",
    "identify",
    "load_model",
    "mjcf",
    "open_atlas",
    "open_log",
    "open_plan",
    "open_planner",
    "open_recording",
    "orbit",
    "picture",
    "plan",
    "polish",
    "prove",
    "reference",
    "run",
    "shadow",
    "swings",
]


def __getattr__(name: str) -> object:
    if name not in __all__:
        raise AttributeError(f"module 'dpcontrol' has no attribute {name!r}")
    import importlib

    value = getattr(importlib.import_module("dpcontrol.api"), name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return [*__all__, "__version__"]
