"""An optimal throw: tensions after which the tip is fastest, by gradients through the simulation.
`python examples/throw.py`"""

import numpy as np
from scipy.optimize import minimize

import soft_tendon_env as ste

PERIOD = 0.02  # [s]
PERIODS = 25
GRAVITY = {"effects.gravity.acceleration": [0.0, 0.0, -9.81]}  # [m/s^2]


def throw(tension, simulation, start):
    """Negative square of the tip's speed [m/s] after tensions (PERIODS n_a,) [N] from a state, and
    its gradient by an adjoint sweep."""
    simulation.state = start
    periods = []
    for command in tension.reshape(PERIODS, -1):
        periods.append(simulation.linearize(command, PERIOD))
        simulation.state = periods[-1].next
    q = simulation.state.q
    q_dot = simulation.state.q_dot
    velocity = (simulation.model.terms(q, q_dot).tip_jacobian @ q_dot)[3:]
    by_state, by_last = np.split(
        -2.0 * velocity @ periods[-1].tip_twist[3:], [len(periods[-1].state)]
    )
    gradient = [by_last]
    for period in periods[-2::-1]:
        gradient.insert(0, by_state @ period.command)
        by_state = by_state @ period.state
    return -velocity @ velocity, np.concatenate(gradient)


if __name__ == "__main__":
    model = ste.build_model(ste.load_scene("three_tendon").replace(GRAVITY), fidelity="fast")
    simulation = ste.Simulation(model)
    start = simulation.reset_at_rest()
    limits = np.array([tendon.tension_limits for tendon in model.scene.tendons])
    pull = np.tile(
        np.where(np.arange(len(limits)) == 0, limits[:, 1], limits[:, 0]), PERIODS
    )  # one tendon, as hard as it may
    found = minimize(
        throw,
        pull,
        (simulation, start),
        jac=True,
        method="L-BFGS-B",
        bounds=np.tile(limits, (PERIODS, 1)),
    )
    for name, tension in (("one tendon pulled", pull), ("optimal", found.x)):
        print(
            f"{name:18} the tip has {np.sqrt(-throw(tension, simulation, start)[0]):.2f} m/s after"
            f" {PERIOD * PERIODS:g} s"
        )
