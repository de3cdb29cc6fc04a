"""Controllers in closed loop: without an environment, told exactly what is."""

from typing import NamedTuple

import numpy as np
import pytest

from soft_tendon_env.control import ControllerInput, Reference
from soft_tendon_env.model.simulation import Simulation


class Tracked(NamedTuple):
    """What happened in `periods` control periods."""

    tension: np.ndarray  # (periods, n_a), as decided
    tip: np.ndarray  # (1 + periods, 4, 4)
    q: np.ndarray  # (1 + periods, n)
    reports: list
    memory: object


@pytest.fixture(scope="session")
def model(build):
    """The arm of tests that hang on no other: three tendons, on few intervals."""
    return build("three_tendon", {"quadrature.intervals": 4})


@pytest.fixture(scope="session")
def limits_of():
    """limits_of(model): tension limits (n_a, 2) of its scene."""
    return lambda model: np.array([tendon.tension_limits for tendon in model.scene.tendons])


@pytest.fixture(scope="session")
def drive():
    """drive(controller, arm, target, periods, ...): the motion of an arm whose controller is told
    `target`, or target(k) in period k.

    arm: a model, at rest without tension, or a simulation to go on with. memory: to begin with.
    period [s]. act: what the tensions decided become in the arm.
    """

    def driven(
        controller, arm, target, periods, memory=None, period=0.02, act=lambda tension: tension
    ):
        simulation = arm if isinstance(arm, Simulation) else Simulation(arm)
        model = simulation.model
        tension = np.zeros(simulation.model.tendon_count)
        tensions = []
        reports = []
        path = [simulation.state.q]
        for k in range(periods):
            state = simulation.state
            wanted = target(k) if callable(target) else target
            decision = controller.act(
                ControllerInput(state.q, state.q_dot, model.tip_pose(state.q), tension, wanted),
                memory,
            )
            tension = decision.tension
            memory = decision.memory
            simulation.step(act(tension), period)
            tensions.append(tension)
            reports.append(decision.report)
            path.append(simulation.state.q)
        tip = np.stack([model.tip_pose(q) for q in path])
        return Tracked(np.array(tensions), tip, np.array(path), reports, memory)

    return driven


@pytest.fixture(scope="session")
def holding():
    """holding(model, tension): the target that is held by tensions, as a pose, a position and a
    shape."""

    def target(model, tension):
        q = model.rest_coordinates(np.asarray(tension, dtype=np.float64))
        pose = model.tip_pose(q)
        return Reference(np.zeros(1), pose[None], pose[None, :3, 3], q[None])

    return target
