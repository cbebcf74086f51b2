"""Rigorous lower bounds of lab's topological entropy against energy, with an estimate in doubles beside each.

    python tests/benchmarks/entropy.py FOLDER            # hours on one core; stop it at any time and start it again

Every energy's graph is proved, and its certificate written to FOLDER/ENERGY.json. Energies with a certificate are not
proved again. Connections that do not close are left out, so the bound is that of the others. Certificates are checked
with `dpcontrol prove check FOLDER/ENERGY.json`. The results are stored in `charts/entropy.json`, from which the picture
`.assets/entropy.png` is drawn.

The estimate uses the connections in the certificate, with durations from their computed phases on the periodic orbits:
at the entropy h, the greatest eigenvalue of exp(-h τ_ij)/(1 - exp(-h T)) over pairs of connections that meet is one.
"""

import json
import sys
from collections.abc import Sequence
from decimal import Decimal
from pathlib import Path

import numpy as np
from scipy.optimize import brentq

import dpcontrol as dp
from dpcontrol.tubes.connections import Connection

ENERGIES = (-0.16, -0.14, -0.12, -0.1, -0.07, -0.03, 0, 0.05, 0.1, 0.15, 0.19, 0.2, 0.22, 0.25, 0.3)
"""J."""
CHART = Path(__file__).parent / "charts" / "entropy.json"
PICTURE = Path(__file__).parents[2] / ".assets" / "entropy.png"


def proved(energy: Decimal, file: Path) -> dict[str, object]:
    """Prove the graph of an energy, and return its row."""
    edges = dp.graph("lab", energy=float(energy))
    if not edges.connections:
        return {"energy": str(energy), "status": "no connections"}
    proof = dp.prove_graph(edges, energy=energy, out=file, yes=True)
    if not proof.proved:
        return {"energy": str(energy), "status": proof.status}
    names = [row["name"] for row in proof.figures["links"]]
    estimate = estimated([c for c in edges.connections if c.name in names], proof.figures["least"])
    row = {"energy": str(energy), "links": len(names), "wraps": proof.figures["wraps"]}
    return {**row, "entropy": proof.figures["entropy"], "estimate": estimate}


def estimated(links: Sequence[Connection], least: Sequence[Sequence[int | None]]) -> float:
    """Return the entropy of walks on computed connections, 1/s."""

    def gap(rate: float) -> float:
        matrix = np.zeros((len(links), len(links)))
        for i, before in enumerate(links):
            for j, after in enumerate(links):
                if (wraps := least[i][j]) is not None:
                    period, phase = before.target.period, (after.phase_out - before.phase_in) % 1.0
                    stay = before.time_in + after.time_out + (wraps + phase) * period
                    matrix[i, j] = np.exp(-rate * stay) / (1 - np.exp(-rate * period))
        return float(np.abs(np.linalg.eigvals(matrix)).max()) - 1

    return round(float(brentq(gap, 1e-3, 20.0)), 4)


def draw(rows: Sequence[dict[str, object]], picture: Path) -> None:
    """Draw bounds and estimates against energy."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(6.4, 3.6), layout="constrained")
    axes = figure.add_subplot()
    energies = [float(str(row["energy"])) for row in rows]
    axes.plot(energies, [row["estimate"] for row in rows], "o", mfc="none", ms=9, label="estimate in doubles")
    axes.plot(energies, [row["entropy"] for row in rows], "k.", label="proved lower bound")
    axes.margins(y=0.1)
    axes.set(xlabel="energy, J", ylabel="topological entropy, 1/s", ylim=(0, None))
    axes.legend(frameon=False)
    figure.savefig(picture, dpi=150)


def main() -> None:
    """Prove what is missing, store the rows, and draw them."""
    folder = Path(sys.argv[1])
    folder.mkdir(parents=True, exist_ok=True)
    rows = {row["energy"]: row for row in json.loads(CHART.read_text(encoding="utf-8"))} if CHART.exists() else {}
    for energy in map(Decimal, sys.argv[2:] or map(str, ENERGIES)):
        file = folder / f"{energy}.json"
        if not (file.exists() and str(energy) in rows):
            rows[str(energy)] = proved(energy, file)
            listed = sorted(rows.values(), key=lambda row: float(row["energy"]))
            CHART.write_text(json.dumps(listed, indent=1) + "\n", encoding="utf-8")
            sys.stdout.write(f"{rows[str(energy)]}\n")
    draw([row for row in sorted(rows.values(), key=lambda row: float(row["energy"])) if "entropy" in row], PICTURE)


if __name__ == "__main__":
    main()
