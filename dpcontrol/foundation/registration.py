"""The environments of dpcontrol for gymnasium, which has no plugins.

They are registered as soon as both packages are imported, in any order. Neither imports the other.
"""

from collections.abc import Sequence
from importlib.machinery import ModuleSpec, PathFinder, SourceFileLoader
from types import ModuleType

ENVIRONMENTS = {
    "SwingUp-v0": ("swing-up-v0", 1000),
    "FromAnywhere-v0": ("from-anywhere-v0", 1000),
    "Twelve-v0": ("twelve-v0", 6000),
}
"""Names in the namespace `dpcontrol`, with the definition and the largest number of steps of an episode."""
_HOME = "dpcontrol.runs.environments"


def register_environments() -> None:
    """Register the environments with gymnasium, so that `gymnasium.make("dpcontrol/SwingUp-v0")` makes one."""
    import gymnasium

    for name, (definition, steps) in ENVIRONMENTS.items():
        gymnasium.register(
            f"dpcontrol/{name}",
            entry_point=f"{_HOME}:BenchEnvironment",
            vector_entry_point=f"{_HOME}:BenchVector",
            max_episode_steps=steps,
            kwargs={"definition": definition, "max_episode_steps": steps},
        )


class _RegisteringLoader(SourceFileLoader):
    """Python's loader of a package, after which the environments are registered."""

    def exec_module(self, module: ModuleType) -> None:
        """Import the package, then register the environments in it."""
        super().exec_module(module)
        register_environments()


def registering_spec(name: str, path: Sequence[str] | None) -> ModuleSpec | None:
    """Return the specification of gymnasium, whose import then registers the environments.

    Args:
        name: "gymnasium".
        path: where to search, None for Python's path.
    """
    spec = PathFinder.find_spec(name, path)
    if spec is not None and isinstance(spec.loader, SourceFileLoader):
        spec.loader = _RegisteringLoader(spec.loader.name, spec.loader.path)
    return spec
