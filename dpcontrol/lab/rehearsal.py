"""Before the first deadline: a few ticks of estimator and controller that nobody sees."""

from dpcontrol.lab.control_loop import ControlLoop


def rehearse(loop: ControlLoop) -> None:
    """Have all that a loop needs compiled and in memory before its first deadline."""
    state, estimator = loop.controller.first_state, loop.estimator
    n = (len(state) - 2) // 2
    measured = state[[*range(n), 2 * n]]
    estimate = estimator.update(estimator.first(state), measured)
    session = loop.controller.begin()
    for tick in range(50):
        estimate = estimator.step(estimate, 0.0, measured)
        session.command(tick, estimator.ahead(estimate, [0.0]), estimate.extra)
