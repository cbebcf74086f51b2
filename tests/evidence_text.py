"""The table of evidence on levels as the package keeps it."""

from dpcontrol.runs.evidence import CART_MASS, LAG, Evidence

HEADING = f"""What each shipped scene needs of the model: `pytest -m benchmark tests/benchmarks/test_level_evidence.py`.
reference: one run on a plant that is the model. plant: runs with the scene's own mismatch; drive: lag {LAG:g} s;
force: a cart of {CART_MASS:g} kg besides. effort: m/s² rms of the cart; error: rad rms of the angles."""


def evidence_text(evidence: list[Evidence]) -> str:
    """Return the table as TOML."""
    lines = [*(f"# {line}" for line in HEADING.splitlines())]
    for found in evidence:
        lines += ["", f"[{found.scene}]", f'motion = "{found.motion}"']
        for key, levels in (("reference", found.references), ("plant", found.plants)):
            lines += [
                f"{key}.{level} = {{ runs = {r.runs}, completed = {r.completed}, effort = {r.effort:.4g}, "
                f"error = {r.error:.4g} }}"
                for level, r in levels.items()
            ]
    return "\n".join(lines) + "\n"
