"""From two known Lyapunov orbits to their L1-L2 connections by hiten; prints one JSON document.

Settings are those of hiten's own example of a heteroclinic connection (200 trajectories a tube, pairing radius 1e-3).
Two settings differ: the plane of the section is (y, ẏ), because the orbits are planar, and the flight time includes
second crossings. A Python with hiten must run this file:
hiten_connection.py '{"mu", "orbits": [[state], [state]], "step", "turns"}'.
"""

import json
import logging
import sys

logging.disable(logging.CRITICAL)

from hiten import System  # noqa: E402
from hiten.algorithms.connections import ConnectionPipeline  # noqa: E402
from hiten.algorithms.connections.config import ConnectionConfig  # noqa: E402
from hiten.algorithms.connections.options import ConnectionOptions  # noqa: E402
from hiten.algorithms.poincare import SynodicMapConfig  # noqa: E402
from hiten.system.orbits.lyapunov import LyapunovOrbit  # noqa: E402

task = json.loads(sys.argv[1])
system = System.from_mu(task["mu"])
tubes, orbits = [], []
# Between the points lie the branch away from the larger body at L1, the one towards it at L2.
for point, stable, side in ((1, False, "positive"), (2, True, "negative")):
    x, y, u, v = task["orbits"][point - 1]
    orbit = LyapunovOrbit(system.get_libration_point(point), initial_state=[x, y, 0.0, u, v, 0.0])
    orbit.correct()
    orbit.propagate()
    orbits.append({"energy": float(orbit.energy), "period": float(orbit.period)})
    tube = orbit.manifold(stable=stable, direction=side)
    tube.compute(step=task["step"], integration_fraction=task["turns"], show_progress=False)
    tubes.append(tube)
section = SynodicMapConfig(section_axis="x", section_offset=1 - task["mu"], plane_coords=("y", "vy"))
pipeline = ConnectionPipeline.with_default_engine(config=ConnectionConfig(section=section, direction=-1))
found = pipeline.solve(*tubes, options=ConnectionOptions(delta_v_tol=1, ballistic_tol=1e-8, eps2d=1e-3)).connections
gaps = [max(abs(float(a) - float(b)) for a, b in zip(c.state_u, c.state_s, strict=True)) for c in found]
sys.stdout.write(json.dumps({"orbits": orbits, "gaps": gaps}) + "\n")
