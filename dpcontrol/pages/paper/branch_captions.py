"""Captions of the branches of connections."""

from dpcontrol.bifurcations.bifurcations import BranchDiagram

MARKS = {"saddle-node": "o", "pitchfork": "^", "section-artefact": "D"}


def pair_name(diagram: BranchDiagram) -> str:
    return f"{diagram.source} to {'itself' if diagram.source == diagram.target else diagram.target}"


def branch_caption(diagrams: list[BranchDiagram]) -> str:
    words = []
    for d in diagrams:
        counted = {kind: sum(m.kind == kind for m in d.marks) for kind in MARKS}
        kinds = ", ".join(f"{n} {kind}{'s' if n > 1 else ''}" for kind, n in counted.items() if n)
        (begin, first, _), (end, last, whole) = d.counts[0], d.counts[-1]
        least = "" if whole else "at least "
        words.append(
            f"{pair_name(d)}: {first} connections at {begin:.4f} J and {least}{last} at {end:.4f} J by {kinds}"
        )
    unexplained = sum(d.unexplained for d in diagrams)
    causes = (
        f"{unexplained} changes of the numbers have no located cause"
        if unexplained
        else "Every change of the numbers has a located cause"
    )
    return (
        "The section crossing of each connection, as energy grows: its angle there (above) and the momentum across "
        "(below). Each curve is a connection followed by continuation, also round folds; marks are events, each "
        "solved separately. Numbers along the lower edge count all connections on the torus; curves show one "
        f"sense, whose mirror images under (θ, ω) → (-θ, -ω) are the other. {_scattering(diagrams)}"
        f"{'; '.join(words)}. {causes}."
    )


def _scattering(diagrams: list[BranchDiagram]) -> str:
    what = (
        "trajectories of a tube pass by another orbit and scatter before they arrive, connections accumulate, and "
        "those found are some of them"
    )
    if any(d.scatters_from is not None for d in diagrams):
        return f"Shaded: {what}. "
    highest = diagrams[2].counts[-1][0]
    return f"Those between different saddles are drawn up to {highest:.3f} J; from about 0.237 J on {what}. "


def branch_differences(diagrams: list[BranchDiagram]) -> str:
    onset = min((m.energy for m in diagrams[2].marks), default=float("nan"))
    return (
        "Folds and splittings are located instead of read off a list of counts. They are distinguished from grazes of "
        "the section, which only change a connection's number of hits. Both orbits exist from 0.1754 J on, which "
        "the paper gives for the onset of heteroclinics; the first of them that meets its section once each appears at "
        f"{onset:.6f} J. With the parameters printed in the paper's text all these energies differ."
    )
