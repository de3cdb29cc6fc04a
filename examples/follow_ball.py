"""A scene, a target and a task of your own, learned: the tip follows a ball on a sphere.
`python examples/follow_ball.py` takes 10 s of a core and needs the extra `agents`.

The task is that of SoRoMoX's study of parallel reinforcement learning
(`paper_results/secVf_parallel_rl`), written anew, with its rod of one piece of constant strain,
which lies along x here. `benchmarks/peer_learning.py` trains on it in three ways, beside their
times."""

import argparse
import time
from typing import Literal

import numpy as np
import torch

import soft_tendon_env as ste
from soft_tendon_env.envs import Task
from soft_tendon_env.envs.observation import Group
from soft_tendon_env.envs.targets import PoseCourse, Target, pose_samples
from soft_tendon_env.envs.tracking import POSITION
from soft_tendon_env.learning.analytic_policy_gradient import APG, APGSettings
from soft_tendon_env.learning.vec_env import make_sb3_vec_env

ID = "TendonRod-FollowBall-v0"
ROWS = 32
PERIOD = 1.0 / 15.0  # between actions [s]
PERIODS = 105  # of an episode
WINDOW = 15  # periods that a gradient goes through
# Rewards of a period that count as 0 and 1.
LEAST = -2.5  # a tip that is further off or leaves faster than ever seen
MOST = 1.5  # a hit

SCENE = ste.Scene(
    name="ball_arm",
    description="Soft rod of 0.25 m with four straight tendons, one piece of constant strain",
    segments=[
        {
            "length": 0.25,
            "young_modulus": 250e3,
            "poisson_ratio": 0.37,
            "density": 1070.0,
            "damping": 1086.0,  # in bending theirs, 3 eta I = 1e-3 N m^2 s
            "radius": 0.025,
        }
    ],
    tendons=[
        {"routing": {"type": "straight", "offset": offset}, "tension_limits": [0.0, 25.0]}
        for offset in ([0.0, 0.02], [0.02, 0.0], [0.0, -0.02], [-0.02, 0.0])
    ],
    strain={
        "type": "explicit",
        "modes": [
            {
                "strains": ["torsion", "bend_y", "bend_z", "stretch", "shear_y", "shear_z"],
                "order": 0,
                "span": "rod",
            }
        ],
    },
    quadrature={"intervals": 4},
)


@ste.register("target", "ball")
class Ball(Target):
    """`{"type": "ball"}`: a ball at `speed` [m/s] on a random path on the upper half of a sphere,
    to its end, back, and so on."""

    type: Literal["ball"] = "ball"
    speed: float = 0.015

    @property
    def is_random(self):
        return True

    def draw(self, generator, setting):
        turns, waves = generator.uniform(0.5, 3.0, 2)
        theta = generator.uniform(0.15, 0.5 * np.pi - 0.25)
        swing = generator.uniform(0.0, 0.35)
        phi, phase = generator.uniform(0.0, 2.0 * np.pi, 2)
        # one way, from 0 to 2 pi: theta swings, and phi goes round
        s = 2.0 * np.pi * np.linspace(0.0, 1.0, 2001)
        swinging = theta + swing * np.sin(waves * s + phase)
        # above the equator, and not at the pole
        theta = np.clip(swinging, 1e-3, 0.5 * np.pi - 1e-3)
        phi = phi + turns * s
        x = np.cos(theta)
        y = np.sin(theta) * np.cos(phi)
        z = np.sin(theta) * np.sin(phi)
        directions = np.stack([x, y, z], axis=1)
        centre = np.array([0.15, 0.0, 0.0])
        return BallCourse(0.1 * directions + centre, self.speed)


class BallCourse(PoseCourse):
    def __init__(self, points, speed):
        steps = np.diff(points, axis=0)
        lengths = np.linalg.norm(steps, axis=1)
        self.points = points
        self.way = np.cumsum([0.0, *lengths])
        self.directions = steps / lengths[:, None]
        self.speed = speed

    def sample(self, times):
        end = self.way[-1]
        gone = self.speed * times % (2.0 * end)
        place = end - np.abs(end - gone)
        sign = np.where(gone < end, 1.0, -1.0)
        pose = np.tile(np.eye(4), (times.size, 1, 1))
        twist = np.zeros((times.size, 6))
        columns = [np.interp(place, self.way, column) for column in self.points.T]
        pose[:, :3, 3] = np.stack(columns, axis=1)
        behind = np.searchsorted(self.way, place, side="right")
        piece = np.clip(behind - 1, 0, len(self.directions) - 1)
        # the ball's frame does not turn
        velocity = self.speed * sign
        twist[:, 3:] = velocity[:, None] * self.directions[piece]
        return pose_samples(pose, twist)


def tip_velocity(seen):
    """(rows, 3) [m/s] in the world, of arrays and of tensors."""
    return (seen.tip_pose[:, :3, :3] @ seen.tip_twist[:, 3:, None])[..., 0]


def ball_error(seen):
    """(rows, 3) [m] in the world, of arrays and of tensors."""
    return seen.target.tip_pose[:, 0, :3, 3] - seen.tip_pose[:, :3, 3]


@ste.register("reward_term", "following")
def following(tracking):
    """Their reward of a period, -(d / 0.2 + max(rate of d, 0) / 0.3), and 1.5 more within 10 mm,
    from LEAST to MOST as 0 to 1."""
    distance = tracking.distance
    off = tracking.tip_pose[:, :3, 3] - tracking.target_pose[:, :3, 3]
    ball_velocity = tracking.target.tip_twist[:, 0, 3:]
    apart = tip_velocity(tracking.reading) - ball_velocity
    leaving = (off * apart).sum(axis=1) / np.maximum(distance, 1e-9)
    is_near = distance < 0.01
    cost = distance / 0.2 + np.maximum(leaving, 0.0) / 0.3
    reward = 1.5 * is_near - cost
    share = (reward - LEAST) / (MOST - LEAST)
    return np.clip(share, 0.0, 1.0)


def their_return(episode_return, periods=PERIODS):
    """Their return of an episode from the sum of its rewards here."""
    return (MOST - LEAST) * episode_return + LEAST * periods


def ball_position(seen):
    """(rows, 3) [m] in the world."""
    return seen.target.tip_pose[:, 0, :3, 3]


def ball_velocity(seen):
    """(rows, 3) [m/s] in the world."""
    return seen.target.tip_twist[:, 0, 3:]


for name, description, values, unit in (
    ("tip_velocity", "the tip's velocity", tip_velocity, 1.0),
    ("ball_position", "the ball's position", ball_position, 1.0),
    ("ball_error", "from the tip to the ball", ball_error, 0.1),
    ("ball_velocity", "the ball's velocity", ball_velocity, 0.1),
):
    unit_of = lambda units, unit=unit: unit * units.length  # noqa: E731
    ste.register("observation_group", name, Group(description, values, unit_of))

ste.register(
    "task",
    "FollowBall",
    Task(
        description="Follow a ball on a sphere with the tip.",
        target="ball",
        observations={
            "full": (
                "tip_position",
                "tip_velocity",
                "command",
                "ball_position",
                "ball_velocity",
            ),  # theirs
            "error": (
                "tip_position",
                "tip_velocity",
                "command",
                "ball_error",
                "ball_velocity",
            ),  # what it tells is the same
        },
        errors=(POSITION,),
        reward={"following": 1.0},
    ),
    max_episode_steps=PERIODS,
)
OPTIONS = {
    "scene": SCENE,
    "fidelity": "scene",
    "control_period": PERIOD,
    "action": "increment",
    "tension_rate": 0.5 / PERIOD,
}


def cost_of(found):
    """Cost of trajectories for the analytic policy gradient: the logarithm of the distance beyond 5
    mm, and a little of the distance."""
    square = found.position_error.square().sum(-1) / 0.005**2
    return (0.5 * square.log1p() + 0.05 * (1.0 + square).sqrt()).mean()


def learner(env, seed=0):
    """The analytic policy gradient on rows of this task that observe the error, whose first
    episodes end one after another."""
    network = {"net_arch": {"pi": [128, 128], "vf": []}, "activation_fn": torch.nn.ELU}
    env.set_options(
        [{"episode_steps": WINDOW * (1 + row % (PERIODS // WINDOW))} for row in range(env.num_envs)]
    )
    rate = {"learning_rate": lambda remaining: 3e-4 * 10.0**remaining}
    return APG(
        "MlpPolicy",
        env,
        settings=APGSettings(n_steps=WINDOW, cost=cost_of),
        policy_kwargs=network,
        seed=seed,
        **rate,
    )


def unseen_env(observation, episodes=50):
    """Rows of this task whose balls no training has met."""
    env = make_sb3_vec_env(ID, episodes, **OPTIONS, observation=observation)
    env.seed(10_000)
    return env


def play(policy, env):
    """Their mean return of an episode a row, and the tip's mean distance from the ball [m]."""
    observation = env.reset()
    total = np.zeros(env.num_envs)
    distances = []
    for _ in range(PERIODS):
        action, _ = policy.predict(observation, deterministic=True)
        observation, rewards, _, infos = env.step(action)
        total += rewards
        distances.append([info["position_error"] for info in infos])
    return their_return(total.mean()), np.mean(distances)


def main(steps):
    torch.set_num_threads(1)
    policy = learner(make_sb3_vec_env(ID, ROWS, threads=1, **OPTIONS, observation="error"))
    before, _ = play(policy, unseen_env("error"))
    print(f"return {before:.1f} before")
    began = time.process_time()
    policy.learn(steps)
    spent = time.process_time() - began
    after, distance = play(policy, unseen_env("error"))
    print(
        f"return {after:.1f}, {1e3 * distance:.1f} mm from the ball in the mean"
        f" after {steps:,} steps, {spent:.0f} s of CPU time"
    )


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--steps", type=int, default=60_000, help="of all arms together")
    main(parser.parse_args().steps)
