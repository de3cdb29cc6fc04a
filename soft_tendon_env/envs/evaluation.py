"""Any policy over a fixed list of episodes, with an arm as its model says or with one that differs from it.

    scores = evaluate(policy, env, EVALUATION_SEEDS)
    print(summarise(scores).errors["position_error"].rms)

A policy is whatever has Stable-Baselines3's `predict`. Errors are the true ones of `info`, whatever the sensors say. See
scores.py for what is made of an episode.
"""

import math
import time
from collections.abc import Iterable, Mapping
from typing import Any, Protocol

import gymnasium as gym
import numpy as np

from soft_tendon_env.checks import checked_type
from soft_tendon_env.envs.episodes import Episodes
from soft_tendon_env.envs.policy import RowMemory
from soft_tendon_env.envs.scores import Episode, EpisodeScore, score
from soft_tendon_env.envs.single import TendonRodEnv
from soft_tendon_env.scene import Array

ROUND_OFF = 1e-6
"""Share of the range of actions and tensions by which they may exceed their bounds: float32 has less."""

MODEL_ERRORS: Mapping[str, Mapping[str, Any]] = {
    "nominal": {},
    "stiffness-20%": {"stiffness": 0.8},
    "stiffness+20%": {"stiffness": 1.2},
    "damping-halved": {"damping": 0.5},
    "damping-doubled": {"damping": 2.0},
    "payload-20g": {"payload": 0.02},  # a tenth of the paper's arm
    "tension-10%": {"tension_gain": 0.9},
    "tension+10%": {"tension_gain": 1.1},
    "noise": {
        "noise": {
            "position": 1e-3,
            "rotation": math.radians(0.5),
            "length": 5e-4,
            "curvature": 0.05,
            "stretch": 1e-3,
            "curvature_rate": 0.5,
            "stretch_rate": 0.01,
        }
    },
    "latency-20ms": {"latency": 0.02},
}
"""What an arm can have that its model has not, by name: values of the option `randomize`."""


class Policy(Protocol):
    """Stable-Baselines3's interface: what was remembered goes in with the observation, and comes out with the action."""

    def predict(self, observation: Any, state: Any = None, episode_start: Any = None, deterministic: bool = False) -> tuple[Any, Any]:
        """The action for an observation, and what to give back as `state` with the next one."""


def evaluate(policy: Policy, env: gym.Env[Any, Any], seeds: Iterable[int], skip: float = 1.0) -> list[EpisodeScore]:
    """Scores of one episode per seed of `reset`; errors count from `skip` [s] on.

    Raises TypeError for environments of other packages, ValueError for episodes that end before `skip` or have no end.
    """
    return [score(run_episode(policy, env, seed), skip) for seed in seeds]


def run_episode(policy: Policy, env: gym.Env[Any, Any], seed: int) -> Episode:
    """Live through an episode of an environment with one arm. Raises TypeError, ValueError for one whose episodes have no end."""
    if isinstance(env, TendonRodEnv):
        raise ValueError("env should end its episodes: make it with gym.make, or wrap it in gymnasium.wrappers.TimeLimit")
    episodes = checked_type("env", env.unwrapped, TendonRodEnv, "made by gym.make('TendonRod-TipPose-v0')").episodes
    observation, info = env.reset(seed=seed)
    infos, tensions = [info], [episodes.tension[0]]
    rewards, violations, seconds = [], [], []
    state, begins, ended = None, np.ones(1, dtype=bool), False
    while not ended:
        started = time.perf_counter()
        action, state = policy.predict(observation, state, begins, deterministic=True)
        seconds.append(time.perf_counter() - started)
        begins = np.zeros(1, dtype=bool)
        violations.append(asks_too_much(action, state, episodes.limits))
        observation, reward, terminated, truncated, info = env.step(action)
        infos.append(info)
        tensions.append(episodes.tension[0])
        rewards.append(float(reward))
        ended = terminated or truncated
    return Episode(
        seed=seed,
        period=episodes.period,
        length=episodes.model.length,
        errors={name: np.array([info[name] for info in infos]) for name in episodes.task.errors},
        reward=np.array(rewards),
        tension=np.array(tensions),
        violation=np.array(violations),
        seconds=np.array(seconds),
        reached=_reached(episodes) if episodes.task.goal else None,
        cause=info.get("cause"),
    )


def _reached(episodes: Episodes) -> bool:
    """Whether the tip truly is at its goal now, whatever its sensors say."""
    return not episodes.diverged[0] and bool(episodes.errors["position_error"][0] <= episodes.options.threshold)


def asks_too_much(action: Any, state: Any, limits: Array) -> bool:
    """Whether an action (n_a,) is beyond [-1, 1], or its controller decided on tensions beyond their limits (n_a, 2) [N].

    `state` is what `predict` returned with the action: what a `ControllerPolicy` decided, before it made an action of it.
    """
    if np.abs(action).max() > 1.0 + 2.0 * ROUND_OFF:
        return True
    memory = state[0] if isinstance(state, tuple) and state else None
    if not isinstance(memory, RowMemory) or memory.decision is None:
        return False
    least, greatest = limits.T
    slack = ROUND_OFF * (greatest - least)
    tension = memory.decision.tension
    return bool((tension < least - slack).any() or (tension > greatest + slack).any())
