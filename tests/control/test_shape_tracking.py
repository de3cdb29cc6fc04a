"""Control of shapes: the paper's laws at short periods, equilibrium, stability at long ones, gains; feedforward of shapes."""

import numpy as np
import pytest

from soft_tendon_env.control import ControllerInput, Reference
from soft_tendon_env.control.paper_laws import energy_left_inverse
from soft_tendon_env.control.shape_tracking import ShapeTracking

PASSIVE = {"strain.passive": [{"strains": ["torsion", "bend_y", "bend_z"], "order": 1, "span": "rod"}]}
INSIDE = {"effects.gravity.acceleration": [0.0, 0.0, -9.81], "strain.include_loads": True}
ARMS = {
    "full": ("paper", None),
    "passive": ("three_tendon", PASSIVE),
    "redundant": ("four_tendon", None),
    "loads inside": ("three_tendon", {**PASSIVE, **INSIDE}),
}


@pytest.fixture(params=ARMS)
def model(build, request):
    return build(*ARMS[request.param])


def wide(model):
    return np.tile([-1e6, 1e6], (model.tendon_count, 1))


def controller_input(model, random_state, period):
    """In motion, towards a target in motion, and the target's rates."""
    q, q_dot = random_state(model, 0)
    goal, rates = random_state(model, 1)
    path = np.stack([goal, goal + period * rates])
    return ControllerInput(q, q_dot, model.tip_pose(q), np.zeros(model.tendon_count), Reference(np.array([0.0, period]), q=path)), rates


def test_short_periods_give_the_paper_s_law(model, random_state):
    """u = q_a_bar + B^+ G (kd (q_bar_dot - q_dot) + kp (q_bar - q)), up to what a period changes: in its tenth a tenth."""
    off = []
    for period in (1e-8, 1e-9):
        now, rates = controller_input(model, random_state, period)
        controller = ShapeTracking(model, wide(model), period, settling_time=0.2, damping=1.0)
        held = np.stack([model.rest_coordinates(unit) for unit in np.eye(model.tendon_count)], axis=1)
        push = controller.kd * (rates - now.q_dot) + controller.kp * (now.reference.q[0] - now.q)
        terms = model.terms(now.q, now.q_dot)
        law = np.linalg.pinv(held) @ now.reference.q[0] + energy_left_inverse(terms) @ terms.stiffness @ push
        forces = terms.actuation @ np.stack([controller.act(now).tension, law], axis=1)  # of redundant tendons only these are determined
        off.append(np.abs(forces[:, 0] - forces[:, 1]).max() / np.abs(forces[:, 1]).max())
    assert off[0] < 1e-3 and off[1] < 0.11 * off[0]


@pytest.mark.parametrize("settling_time, damping", [(0.4, 10.0), (0.2, 1.0)])
def test_the_loop_is_stable_and_settles_at_twenty_milliseconds(build, drive, holding, settling_time, damping):
    """The paper's gains (0.4 s, 10) too, within limits."""
    model = build("paper")
    controller = ShapeTracking(model, np.tile([0.0, 60.0], (10, 1)), 0.02, settling_time=settling_time, damping=damping)
    target = holding(model, [20.0, 5.0, 2.0, 2.0, 2.0, 10.0, 2.0, 2.0, 2.0, 2.0])
    motion = drive(controller, model, target, 150)
    off = np.linalg.norm(motion.tip[:, :3, 3] - target.tip_position[0], axis=1)
    took = 0.02 * np.flatnonzero(off > 0.02 * off[0])[-1]
    assert off[0] > 0.05 * model.length and off[-10:].max() < 1e-3 * model.length
    assert took < 2.5 * settling_time
