"""Feedback linearisation of the tip: the paper's law at short periods, the exponential of its gains at those that there are."""

import numpy as np
import pytest

from soft_tendon_env.control import ControllerInput, Reference, tip_tracking
from soft_tendon_env.control.objectives import TipPose, TipPosition
from soft_tendon_env.control.paper_laws import Gains, TipPoseTarget, accelerating_tension, energy_left_inverse, tip_pose_tension
from soft_tendon_env.control.rigid_motions import adjoint, inverse_pose, moved_pose
from soft_tendon_env.control.tip_tracking import TipTracking

PERIOD = 0.02
WIDE = np.tile([-100.0, 100.0], (10, 1))
SETTLING = 0.2
HELD = 12.0 + 4.0 * np.sin(np.arange(10.0))
TWIST = np.array([8.0, -6.0, 4.0, 1.0, -2.0, 1.5])
PAPER_GAINS = Gains(400.0, 40.0)  # of a double pole at -4 / SETTLING


@pytest.fixture(scope="module")
def model(build):
    return build("paper")


@pytest.fixture
def near(model, holding):
    """A target and the tensions that hold it, as a governor tells them."""
    return holding(model, HELD)._replace(tension=HELD)


def pose_law(terms, q_dot, pose, twist):
    return tip_pose_tension(terms, q_dot, TipPoseTarget(pose, twist, np.zeros(6)), PAPER_GAINS)


def position_law(terms, q_dot, pose, twist):
    """(39) for the position alone, whose error in space obeys e_ddot + kd e_dot + kp e = 0."""
    angular, linear = np.split(terms.tip_jacobian @ q_dot, 2)
    R, r = terms.tip_pose[:3, :3], terms.tip_pose[:3, 3]
    r_ddot = PAPER_GAINS.kd * (pose[:3, :3] @ twist[3:] - R @ linear) + PAPER_GAINS.kp * (pose[:3, 3] - r)
    return accelerating_tension(terms, q_dot, slice(3, 6), R.T @ r_ddot - np.cross(angular, linear), energy_left_inverse)


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("moves", [(0.0, 0.0), (1.0, 0.0), (0.0, 1.0)], ids=["still", "as the tip", "otherwise"])
@pytest.mark.parametrize("objective, law", [(TipPose(0.1), pose_law), (TipPosition(), position_law)], ids=["pose", "position"])
def test_short_periods_give_the_paper_s_law(model, random_state, monkeypatch, objective, law, moves, seed):
    """(39) in the limit, when nothing but the task counts, for targets that stand still, move as the tip does or with a twist of their
    own, whose derivative is taken in the frame of the tip, which moves: what is left falls with the period."""
    monkeypatch.setattr(tip_tracking, "FREE", 1e-5)
    q, q_dot = random_state(model, seed)
    terms = model.terms(q, q_dot)
    pose = moved_pose(terms.tip_pose, np.array([0.1, -0.2, 0.1, 0.02, 0.03, -0.02]))
    twist = moves[0] * (adjoint(inverse_pose(pose) @ terms.tip_pose) @ terms.tip_jacobian @ q_dot) + moves[1] * TWIST
    if isinstance(objective, TipPosition):
        twist[:3] = 0.0  # a straight way
    expected, off = law(terms, q_dot, pose, twist), []
    for period in (1e-5, 1e-6, 1e-7):
        poses = np.stack([moved_pose(pose, k * period * twist) for k in range(3)])
        now = ControllerInput(q, q_dot, terms.tip_pose, np.zeros(10), Reference(period * np.arange(3.0), poses, poses[:, :3, 3]))
        found = TipTracking(model, np.tile([-1e6, 1e6], (10, 1)), period, objective, settling_time=SETTLING).act(now).tension
        off.append(np.linalg.norm(found - expected) / np.linalg.norm(expected))
    assert off[0] < 0.1 and off[1] < 0.15 * off[0] + 1e-4 and off[2] < 2e-3


@pytest.mark.parametrize("objective", [TipPose(0.1), TipPosition()], ids=["pose", "position"])
@pytest.mark.parametrize("settling_time", [0.2, 0.4])
def test_errors_fall_as_the_gains_say(model, near, drive, objective, settling_time):
    """To 2 % within about the settling time: a double pole takes 1.46 of it, and limits some periods."""
    motion = drive(TipTracking(model, WIDE, PERIOD, objective, settling_time=settling_time), model, near, 100)
    away = np.linalg.norm(motion.tip[:, :3, 3] - near.tip_position[0], axis=1)
    took = PERIOD * (1 + np.flatnonzero(away > 0.02 * away[0])[-1])
    assert away[0] > 0.05 * model.length and away[-1] < 1e-4 * model.length
    assert 0.5 * settling_time < took < 1.46 * settling_time + 3.0 * PERIOD
