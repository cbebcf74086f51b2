"""Trajectory design and control for a laboratory double pendulum on a cart.

`import dpcontrol as dp` offers the functions of `dpcontrol.api`, each loaded when it is first used.
"""

import sys

TYPE_CHECKING = False  # typing's own takes as long to import as all of this
if TYPE_CHECKING:
    from collections.abc import Sequence
    from importlib.machinery import ModuleSpec

    from dpcontrol.api import (
        CampaignSettings,
        Estimator,
        GoalMissed,
        InputError,
        Law,
        Limits,
        Model,
        NightSettings,
        Plant,
        Reading,
        ReferenceSettings,
        Rig,
        Section,
        Setpoint,
        Sizes,
        SymbolicLaw,
        SymbolicPlant,
        System,
        Terms,
        atlas,
        cache,
        campaign,
        check_proof,
        closed_loop,
        commission,
        compare_logs,
        config,
        connections,
        count_walks,
        demo,
        describe,
        design_experiments,
        draw_charts,
        draw_figures,
        equilibria,
        explore_energies,
        export,
        family,
        find_bifurcations,
        find_connections,
        find_orbits,
        find_walks,
        flight,
        graph,
        identify,
        import_recording,
        launch,
        learn,
        list_walks,
        load_model,
        log_summary,
        mjcf,
        open_atlas,
        open_campaign,
        open_log,
        open_night,
        open_plan,
        open_planner,
        open_recording,
        open_reference,
        orbit,
        picture,
        plan,
        polish,
        preflight,
        prove,
        prove_graph,
        prove_statement,
        random_walks,
        read_guide,
        recover_log,
        reference,
        refine,
        repeat,
        replay,
        report,
        review,
        rig_link,
        rotating_families,
        rotating_orbits,
        run,
        schema,
        score,
        shadow,
        shortest_walk,
        start_bench,
        sustained_orbit,
        swings,
        symbol_changes,
        transport,
        write_recording,
    )
    from dpcontrol.foundation.version import __version__ as __version__

__all__ = [
    "CampaignSettings",
    "Estimator",
    "GoalMissed",
    "InputError",
    "Law",
    "Limits",
    "Model",
    "NightSettings",
    "Plant",
    "Reading",
    "ReferenceSettings",
    "Rig",
    "Section",
    "Setpoint",
    "Sizes",
    "SymbolicLaw",
    "SymbolicPlant",
    "System",
    "Terms",
    "atlas",
    "cache",
    "campaign",
    "check_proof",
    "closed_loop",
    "commission",
    "compare_logs",
    "config",
    "connections",
    "count_walks",
    "demo",
    "describe",
    "design_experiments",
    "draw_charts",
    "draw_figures",
    "equilibria",
    "explore_energies",
    "export",
    "family",
    "find_bifurcations",
    "find_connections",
    "find_orbits",
    "find_walks",
    "flight",
    "graph",
    "identify",
    "import_recording",
    "launch",
    "learn",
    "list_walks",
    "load_model",
    "log_summary",
    "mjcf",
    "open_atlas",
    "open_campaign",
    "open_log",
    "open_night",
    "open_plan",
    "open_planner",
    "open_recording",
    "open_reference",
    "orbit",
    "picture",
    "plan",
    "polish",
    "preflight",
    "prove",
    "prove_graph",
    "prove_statement",
    "random_walks",
    "read_guide",
    "recover_log",
    "reference",
    "refine",
    "repeat",
    "replay",
    "report",
    "review",
    "rig_link",
    "rotating_families",
    "rotating_orbits",
    "run",
    "schema",
    "score",
    "shadow",
    "shortest_walk",
    "start_bench",
    "sustained_orbit",
    "swings",
    "symbol_changes",
    "transport",
    "write_recording",
]
_HOMES = {
    "CampaignSettings": "runs.campaign",
    "Estimator": "loop.protocols:UserEstimator",
    "GoalMissed": "foundation.errors",
    "InputError": "foundation.errors",
    "Law": "loop.protocols:UserLaw",
    "Limits": "references.problem",
    "Model": "plans.model",
    "NightSettings": "runs.night",
    "Plant": "loop.protocols:UserPlant",
    "Reading": "loop.result",
    "ReferenceSettings": "references.problem",
    "Rig": "loop.protocols:UserRig",
    "Section": "dynamics.propagator",
    "Setpoint": "control.symbolic",
    "Sizes": "dynamics.components",
    "SymbolicLaw": "control.symbolic",
    "SymbolicPlant": "dynamics.components",
    "System": "dynamics.system",
    "Terms": "dynamics.components",
    "__version__": "foundation.version",
    "load_model": "plans.model",
}
"""Modules of the names that are not functions of `dpcontrol.api`, and their names there if they differ."""


class _GymnasiumFinder:
    """Finds gymnasium as Python does, and registers the environments after its import."""

    @staticmethod
    def find_spec(name: str, path: "Sequence[str] | None", target: object = None) -> "ModuleSpec | None":
        """Return the specification of gymnasium that registers the environments of dpcontrol, None for other modules.

        Python asks each finder in `sys.meta_path` for a module that it imports.

        Args:
            name: name of the imported module.
            path: folders to search, None for Python's path.
            target: module to reload, which is not needed here.
        """
        if name != "gymnasium":
            return None
        from dpcontrol.foundation.registration import registering_spec

        return registering_spec(name, path)


if "gymnasium" in sys.modules:
    from dpcontrol.foundation.registration import register_environments

    register_environments()
else:
    sys.meta_path.insert(0, _GymnasiumFinder)


def __getattr__(name: str) -> object:
    """Import the module of a name when the name is first used, and return its value."""
    if name not in __dir__():
        raise AttributeError(f"module 'dpcontrol' has no attribute {name!r}")
    import importlib

    module, _, name_there = _HOMES.get(name, "api").partition(":")
    value = getattr(importlib.import_module(f"dpcontrol.{module}"), name_there or name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return [*__all__, "__version__"]
