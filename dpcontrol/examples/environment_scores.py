# %% [markdown]
# # Scores on the environments
# The laws of dpcontrol fly the definitions of the environments, and each environment repeats their commands. A run and
# an episode with the same seed have the same bench, so the environment repeats the run to the last bit and gives its
# score. It needs `pip install 'dpcontrol[gym]'`.

# %%
import sys
from typing import Any

import dpcontrol as dp

import gymnasium  # isort: skip
import numpy as np
from matplotlib.figure import Figure

from dpcontrol.runs.environments import DEFINITIONS

LAWS: list[tuple[str, str, dict[str, Any]]] = [
    ("SwingUp-v0", "planned transfer, then `lqr`", {}),
    ("SwingUp-v0", "flight, then `lqr`", {"start": "anywhere"}),
    ("FromAnywhere-v0", "flight, then `lqr`", {}),
    ("Twelve-v0", "planned transfers by `adaptive`", {}),
]
"""Environments, laws and their settings."""


def score(name: str, seed: int, **settings: Any) -> tuple[float, float]:
    """Return the return of a law's episode, and the largest difference of the states from those of its run.

    Args:
        name: name of the environment.
        seed: seed of bench and episode.
        settings: of the run.
    """
    env: Any = gymnasium.make(f"dpcontrol/{name}")
    definition = str(DEFINITIONS / f"{env.spec.kwargs['definition']}.toml")
    log = dp.run(definition, seed=seed, **settings).log
    env.reset(seed=seed)
    bench, total, apart = env.unwrapped.vector, 0.0, 0.0
    for command, truth in zip(log.controls["command"], log.states["truth"], strict=True):
        apart = max(apart, float(np.abs(bench.bench.truth[:, 0] - truth).max()))
        _, reward, ended, cut, _ = env.step(np.array([command / bench.itinerary.limits.acceleration]))
        total += float(reward)
        if ended or cut:
            break
    return total, apart


# %%
if __name__ == "__main__":
    seeds = range(int(sys.argv[1]) if sys.argv[1:] and sys.argv[1].isdigit() else 3)
    figure = Figure(figsize=(7, 3), layout="constrained")
    axes = figure.subplots()
    for place, (name, law, settings) in enumerate(LAWS):
        returns = [score(name, seed, **settings)[0] for seed in seeds]
        print(f"| {name} | {law} | {np.mean(returns):.1f} | {min(returns):.1f} | {max(returns):.1f} |")
        most = 12 if name.startswith("Twelve") else 1000
        axes.plot(np.array(returns) / most, [place] * len(returns), "k|")
    axes.set(xlabel="return over the greatest", xlim=(0, 1.02), yticks=range(len(LAWS)))
    axes.set_yticklabels([f"{name}\n{law}" for name, law, _ in LAWS])
    figure.savefig("environment-scores.png", dpi=110)
