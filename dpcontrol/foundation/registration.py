"""The environments of dpcontrol for gymnasium, which has no plugins.

They are registered as soon as both packages are imported, in any order. Neither imports the other.
"""

import sys
from collections.abc import Sequence
from importlib.machinery import ModuleSpec, PathFinder
from types import ModuleType

ENVIRONMENTS = {
    "SwingUp-v0": ("swing-up-v0", 1000),
    "FromAnywhere-v0": ("from-anywhere-v0", 1000),
    "Twelve-v0": ("twelve-v0", 6000),
}
"""Names in the namespace `dpcontrol`, with the definition and the largest number of steps of an episode."""
_HOME, _PACKAGE = "dpcontrol.runs.environments", "gymnasium"


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


class _Finder:
    """Finds gymnasium as Python does, and registers the environments after its import."""

    def find_spec(
        self, fullname: str, path: Sequence[str] | None, target: ModuleType | None = None
    ) -> ModuleSpec | None:
        found = PathFinder.find_spec(fullname, path, target) if fullname == _PACKAGE else None
        if found is not None and found.loader is not None:
            execute = found.loader.exec_module

            def executed(module: ModuleType) -> None:
                execute(module)
                register_environments()

            found.loader.exec_module = executed
        return found


def offer_environments() -> None:
    """Register the environments now, or when gymnasium is imported."""
    if _PACKAGE in sys.modules:
        register_environments()
    else:
        sys.meta_path.insert(0, _Finder())
