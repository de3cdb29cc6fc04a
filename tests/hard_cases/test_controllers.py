"""Controllers where they are told more than the nominal task asks of them."""

import numpy as np
import pytest

from soft_tendon_env.control import ControllerInput, Reference, tip_tracking
from soft_tendon_env.control.objectives import TipPose
from soft_tendon_env.control.paper_laws import Gains, TipPoseTarget, tip_pose_tension
from soft_tendon_env.control.rigid_motions import moved_pose
from soft_tendon_env.control.tip_tracking import TipTracking

GAINS = Gains(400.0, 40.0)  # of a double pole at -4 / 0.2 s
PERIODS = 1e-6, 1e-7


@pytest.mark.parametrize("speed", [0.1, 1.0, 10.0])
def test_target_with_a_twist_of_its_own(build, random_state, monkeypatch, measured, speed):
    """The acceleration of a target that turns otherwise than the tip, seen from the tip's frame,
    which turns too: -ad_eta(Ad eta_bar) + ... Expected: the law at the control period becomes (39)
    as the period vanishes, the faster the target the more of it is that term."""
    monkeypatch.setattr(tip_tracking, "FREE", 1e-6)
    model = build("paper")
    rng = np.random.default_rng(3)
    for seed in range(3):
        q, q_dot = random_state(model, seed)
        terms = model.terms(q, q_dot)
        twist = speed * rng.normal(size=6)
        pose = moved_pose(terms.tip_pose, 0.1 * rng.normal(size=6))
        expected = tip_pose_tension(terms, q_dot, TipPoseTarget(pose, twist, np.zeros(6)), GAINS)
        off = []
        for period in PERIODS:
            poses = np.stack([moved_pose(pose, k * period * twist) for k in range(3)])
            now = ControllerInput(
                q, q_dot, terms.tip_pose, np.zeros(10), Reference(period * np.arange(3.0), poses)
            )
            tracking = TipTracking(
                model, np.tile([-1e9, 1e9], (10, 1)), period, TipPose(0.1), settling_time=0.2
            )
            off.append(
                np.linalg.norm(tracking.act(now).tension - expected) / np.linalg.norm(expected)
            )
        measured("off (39) at 0.1 microseconds", off[-1])
        assert off[-1] < 1e-3
        assert off[-1] < 0.2 * off[0] + 1e-5
