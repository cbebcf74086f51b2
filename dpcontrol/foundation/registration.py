"""The environments of dpcontrol for gymnasium, which has no plugins.

They are registered as soon as both packages are imported, in any order. Neither imports the other.
"""

from collections.abc import Sequence
from importlib.machinery import ModuleSpec, PathFinder
from types import ModuleType

ENVIRONMENTS = {
    "SwingUp-v0": ("swing-up-v0", 1000),
    "FromAnywhere-v0": ("from-anywhere-v0", 1000),
    "Twelve-v0": ("twelve-v0", 6000),
}
"""Names in the namespace `dpcontrol`, with the definition and the largest number of steps of an episode."""
_HOME = "dpcontrol.runs.environments"


def register_environments() -> None:
    """Register the environments."""
    import gymnasium

    for name, (definition, steps) in ENVIRONMENTS.items():
        gymnasium.register(
            f"dpcontrol/{name}",
            entry_point=f"{_HOME}:BenchEnvironment",
            vector_entry_point=f"{_HOME}:BenchVector",
            max_episode_steps=steps,
            kwargs={"definition": definition, "max_episode_steps": steps},
        )


def registering_spec(name: str, path: Sequence[str] | None) -> ModuleSpec | None:
    """Return the specification of gymnasium, whose import then registers the environments.

    Args:
        name: "gymnasium".
        path: where to search, None for Python's path.
    """
    found = PathFinder.find_spec(name, path)
    if found is not None and found.loader is not None:
        execute = found.loader.exec_module

        def executed(module: ModuleType) -> None:
            execute(module)
            register_environments()

        found.loader.exec_module = executed
    return found
