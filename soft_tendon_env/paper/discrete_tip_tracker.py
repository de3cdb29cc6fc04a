"""(39) made usable: the package's tip tracker in TendonRod-TipPose-v0, on the same circle, at a control period that can be kept."""

from typing import NamedTuple

import gymnasium as gym
import numpy as np
from tqdm import tqdm

from soft_tendon_env.control import Controller
from soft_tendon_env.control.feedforward import StaticFeedforward
from soft_tendon_env.control.objectives import TipPose
from soft_tendon_env.control.reference_governor import ReferenceGovernor
from soft_tendon_env.control.tip_tracking import TipTracking
from soft_tendon_env.envs import IDS
from soft_tendon_env.envs.episodes import Episodes, episodes_of
from soft_tendon_env.envs.targets.motions import Circle
from soft_tendon_env.evaluation.play import play_steps
from soft_tendon_env.paper.motion import Motion
from soft_tendon_env.policies.controller_policy import ControllerPolicy, interface_of

PERIOD = 0.02  # [s]
LIMITS = (-60.0, 60.0)  # [N]
GAINS = {"settling_time": 0.396, "damping": 5.0, "integral_time": 0.5}  # kp and kd of the paper at vanishing periods, and an integral


class Tracked(NamedTuple):
    """A scene, and whether the controller is told the tensions that would hold the target at rest, as in the catalogue."""

    scene: str
    feedforward: bool = True


def track(design: Tracked, circle: Circle, duration: float) -> Motion:
    """An episode of `duration` [s], sampled at the ends of the control periods; tensions are those of the period that ends."""
    count = round(duration / PERIOD)
    env = gym.make(
        IDS["TipPose"],
        scene=design.scene,
        target=circle.model_dump(),
        tension_limits=LIMITS,
        control_period=PERIOD,
        preview=(PERIOD, 2.0 * PERIOD),
        max_episode_steps=count,
    )
    episodes = episodes_of(env)
    policy = ControllerPolicy(controller_of(design, episodes), interface_of(env))
    samples, label = [], f"Figures 5 and 6, {design.scene} at {1e3 * PERIOD:g} ms"
    for step in tqdm(play_steps(policy, env, [0]), label, total=count + 1, unit="step", leave=False):
        samples.append(sample(episodes))
        if step.ended.any():
            break
    return Motion(PERIOD * np.arange(len(samples)), *(np.stack(values) for values in zip(*samples, strict=True)))


def controller_of(design: Tracked, episodes: Episodes) -> Controller:
    model, limits, aim = episodes.model, episodes.limits, TipPose(0.1 * episodes.model.length)
    tracking = TipTracking(model, limits, PERIOD, aim, **GAINS)
    return ReferenceGovernor(StaticFeedforward(model, limits, PERIOD, aim), tracking) if design.feedforward else tracking


def sample(episodes: Episodes) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Coordinates (n,), tip (3,) [m] and tensions (n_a,) [N], copied."""
    arms = episodes.arms
    return arms.rows.q[0].copy(), arms.reading.tip_pose[0, :3, 3].copy(), episodes.tension[0].copy()
