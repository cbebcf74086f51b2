"""The verbs of the command line: a row for each, which names its function in `dpcontrol.api`."""

from collections.abc import Mapping
from typing import NamedTuple


class Verb(NamedTuple):
    """A verb of the command line.

    Attributes:
        summary: its line in the list of verbs.
        function: name of its function in `dpcontrol.api`.
        example: a command line for the help.
        note: further text beside the example.
        names: options of parameters whose name on the command line differs, such as {"source": "--from"}.
        draws: True for a verb whose result is drawn on request, by --picture.
    """

    summary: str
    function: str
    example: str
    note: str = ""
    names: Mapping[str, str | tuple[str, ...]] = {}
    draws: bool = False


GROUPS = {
    "Start": {
        "demo": Verb(
            "Plan, run, score and draw one itinerary.",
            "demo",
            "dpcontrol demo --itinerary cross",
            names={"itinerary": "--itinerary"},
        ),
        "model": Verb(
            "Show a model: parameters, equilibria, eigenvalues.",
            "describe",
            "dpcontrol model lab",
            "MODEL is a name (in ./models or shipped) or a path of a .toml, .urdf or .xml file.",
        ),
        "guide": Verb(
            "Show a page of the guide, or list its pages.",
            "read_guide",
            "dpcontrol guide start",
            "`dpcontrol guide` lists the pages in reading order.",
        ),
        "config": Verb(
            "Show the defaults of the command line, and where each comes from.", "config", "dpcontrol config"
        ),
        "cache": Verb(
            "List the cached results with their sizes, or delete them.",
            "cache",
            "dpcontrol cache --clear",
            "The folder is $DPCONTROL_CACHE, else ~/.cache/dpcontrol.",
        ),
    },
    "Design": {
        "orbit": Verb(
            "Compute a Lyapunov orbit, or its family, and its Floquet multipliers.",
            "find_orbits",
            "dpcontrol orbit lab --saddle down-up --energy -0.07",
        ),
        "connect": Verb(
            "Find all homoclinic or heteroclinic connections of an energy.",
            "find_connections",
            "dpcontrol connect lab --from down-up --to up-down --energy 0.2",
            names={"source": "--from", "target": "--to"},
            draws=True,
        ),
        "bifurcations": Verb(
            "Find the energies at which connections appear, split or change their hits.",
            "find_bifurcations",
            "dpcontrol bifurcations lab --from down-up --to down-up --energies -0.11 -0.09",
            names={"source": "--from", "target": "--to"},
            draws=True,
        ),
        "atlas": Verb(
            "Compute all orbits, tubes and connections of an energy.",
            "atlas",
            "dpcontrol atlas lab --energy 0.2",
            "then: dpcontrol review FILE",
            draws=True,
        ),
        "walk": Verb(
            "List, count and create walks on the connection graph, and their orbits.",
            "find_walks",
            'dpcontrol walk lab --energy 0.2 -s "down-up +" -s "down-up > up-down" --solve',
            names={"symbols": ("-s", "--symbol"), "source": "--from", "target": "--to"},
        ),
        "prove": Verb(
            "Prove that orbits, walks or all walks on a graph exist, or check a certificate.",
            "prove_statement",
            "dpcontrol prove orbit lab --saddle down-up --energy -0.07",
            "For check, MODEL is the file of a certificate.",
            {"symbols": ("-s", "--symbol"), "source": "--from", "target": "--to", "names": "--name"},
        ),
        "plan": Verb(
            "Plan an itinerary: shadowing orbit and reference.",
            "plan",
            "dpcontrol plan outer-turn",
            "ITINERARY is a name (in ./itineraries or shipped) or the path of a .toml, or of a plan from --out.",
            draws=True,
        ),
        "reference": Verb(
            "Show a reference: limits, effort, mesh, error, picture.",
            "open_reference",
            "dpcontrol plan cross --out cross.npz; dpcontrol reference cross.npz",
        ),
        "schema": Verb(
            "Print the JSON Schema of itineraries or models, for editors.", "schema", "dpcontrol schema itinerary"
        ),
        "planner": Verb(
            "Plan in the browser, from an energy to a run.",
            "open_planner",
            "dpcontrol planner lab",
            "MODEL is a name (in ./models or shipped) or a path.",
        ),
    },
    "Run": {
        "run": Verb(
            "Run an itinerary in closed loop and write its log.",
            "launch",
            "dpcontrol run outer-turn --seed 3 --mismatch 0.05",
            names={"source": "--from", "program": "--controller-program", "log": "--out"},
        ),
        "learn": Verb(
            "Learn the arms from runs, and plan their itinerary again.",
            "learn",
            "dpcontrol learn logs/outer-turn-3.mcap --json",
            "then: dpcontrol run models/outer-turn-learnt.npz",
        ),
        "export": Verb(
            "Write the controller of an itinerary as C for your own target.",
            "export",
            "dpcontrol export outer-turn --out controller --float",
            names={"folder": "--out", "single": "--float", "unit": "--fmu"},
        ),
        "campaign": Verb(
            "Run an itinerary with many seeds and count the completed runs.",
            "campaign",
            "dpcontrol campaign outer-turn --runs 200 --mismatch 0.05 --lag 0.005",
            names={"first_seed": "--seed-from"},
        ),
        "rig": Verb(
            "Start an example bench for runs over UDP in real time.",
            "start_bench",
            "dpcontrol rig outer-turn --port 47000 --mismatch 0.05",
            names={"faults": "--fault"},
        ),
        "commission": Verb(
            "Measure a rig before its first run: signs, scales, delay, switches.",
            "commission",
            "dpcontrol commission outer-turn --fault encoder-2-reversed",
            "exits with 1",
            names={"faults": "--fault"},
        ),
        "preflight": Verb(
            "Predict whether a first run completes, and find helpful changes.",
            "preflight",
            "dpcontrol preflight turn-from-rest --lag 0.005 --picture preflight.pdf",
            names={"first_seed": "--seed-from"},
        ),
    },
    "Review": {
        "score": Verb(
            "Report whether logged runs completed their itineraries.",
            "score",
            "dpcontrol score logs/outer-turn-0.mcap --why",
        ),
        "review": Verb(
            "Open a log in the viewer, or save a recording or a picture.",
            "review",
            "dpcontrol review logs/outer-turn-0.mcap --picture outer-turn.png",
        ),
        "report": Verb(
            "Write one page on a log or a campaign.",
            "report",
            "dpcontrol report logs/outer-turn-0.mcap --picture outer-turn.pdf",
            names={"page": "--picture"},
        ),
        "info": Verb(
            "Show the contents of a log: topics, rates, metadata, attachments.",
            "log_summary",
            "dpcontrol info logs/outer-turn-0.mcap",
        ),
        "recover": Verb(
            "Rebuild a truncated or damaged log, and report the losses.",
            "recover_log",
            "dpcontrol recover logs/outer-turn-0.mcap.partial",
            names={"out": "--out"},
        ),
    },
    "Recordings": {
        "import": Verb(
            "Import a recording of the bench as a log.",
            "import_recording",
            "dpcontrol import swing.csv --mapping my-rig.toml --repair nan,gaps",
            names={"repairs": "--repair"},
        ),
        "identify": Verb(
            "Identify a model from recordings of the bench.",
            "identify",
            "dpcontrol identify logs/lab_free_swing.mcap --model lab --out models/rig.toml",
        ),
        "replay": Verb(
            "Predict a recording by a model, and run an estimator over it.",
            "replay",
            "dpcontrol replay logs/lab_free_swing.mcap --model lab --estimator ukf",
        ),
    },
    "Charts": {
        "figures": Verb(
            "Draw the computational figures of the paper, with captions.",
            "draw_figures",
            "dpcontrol figures cuts heteroclinics --out pictures",
            names={"folder": "--out"},
        ),
        "bench": Verb(
            "Chart speed against accuracy, and the limits of methods.",
            "draw_charts",
            "dpcontrol bench propagation --quick --out charts",
            names={"folder": "--out"},
        ),
    },
}
"""Verbs by heading, in the order of work, each with its module and a summary."""
VERBS = {verb: entry for verbs in GROUPS.values() for verb, entry in verbs.items()}
