"""Any policy over a fixed list of episodes, with an arm as its model says or with one that differs from it.

    scores = evaluate(policy, env, EVALUATION_SEEDS)
    print(summarise(scores).errors["position_error"].rms)

A policy is whatever has Stable-Baselines3's `predict`. Errors are the true ones of `info`, whatever the sensors say. See
scores.py for what is made of an episode.
"""

import math
import time
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import gymnasium as gym
import numpy as np
from gymnasium.vector import AutoresetMode

from soft_tendon_env.envs.episodes import Episodes
from soft_tendon_env.envs.single import TendonRodEnv
from soft_tendon_env.envs.vector import TendonRodVectorEnv
from soft_tendon_env.evaluation.scores import Episode, EpisodeScore, score
from soft_tendon_env.policies.controller_policy import RowMemory
from soft_tendon_env.policies.protocol import Policy
from soft_tendon_env.scene.scene import Array
from soft_tendon_env.tools.checks import checked_type
from soft_tendon_env.tools.configuration import not_among

ROUND_OFF = 1e-6
"""Share of the range of actions and tensions by which they may exceed their bounds: float32 has less."""

EVALUATION_SEEDS = tuple(range(1_000_000, 1_000_020))
"""Seeds of `reset` for evaluation: the fixed list of targets on which agents and controllers are compared."""

VALIDATION_SEEDS = tuple(range(3_000_000, 3_000_100))
"""Seeds of `reset` for validation: learning curves are of these, and the best agent of a training is chosen on them, so that the evaluation
seeds have had no part in what is judged on them."""

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


AND = ","
"""Between the names of model errors that an arm has together."""


def model_error(name: str) -> dict[str, Any]:
    """What an arm has, as values of the option `randomize`: of a name in MODEL_ERRORS, or of several, "stiffness+20%,payload-20g".

    Raises ValueError for names that there are not, and where two say the same.
    """
    found: dict[str, Any] = {}
    for part in name.split(AND):
        if part not in MODEL_ERRORS:
            raise ValueError(f"names {part!r}: {not_among(part, MODEL_ERRORS)}; several at once with {AND!r} between them")
        if twice := found.keys() & MODEL_ERRORS[part].keys():
            raise ValueError(f"names {name!r}, in which {', '.join(sorted(twice))} is said twice")
        found |= MODEL_ERRORS[part]
    return found


def evaluate(policy: Policy, env: gym.Env[Any, Any], seeds: Iterable[int], skip: float = 1.0) -> list[EpisodeScore]:
    """Scores of one episode per seed of `reset`; errors count from `skip` [s] on.

    Raises TypeError for environments of other packages, ValueError for episodes that end before `skip` or have no end.
    """
    return [score(run_episode(policy, env, seed), skip) for seed in seeds]


def evaluate_rows(policy: Policy, envs: gym.vector.VectorEnv[Any, Any, Any], seeds: Sequence[int], skip: float = 1.0) -> list[EpisodeScore]:
    """As `evaluate`, all episodes at once: row i of a vector environment lives through the one of seeds[i].

    The same numbers as one by one, where the policy treats rows as it treats single observations; but for the time per action, which is
    the time of all rows divided by their number, and what each observes of the model. Raises as `evaluate`, ValueError unless there is a
    row per seed.
    """
    return [score(episode, skip) for episode in run_rows(policy, envs, seeds)]


def run_episode(policy: Policy, env: gym.Env[Any, Any], seed: int) -> Episode:
    """Live through an episode of an environment with one arm. Raises TypeError, ValueError for one whose episodes have no end."""
    if isinstance(env, TendonRodEnv):
        raise ValueError("env should end its episodes: make it with gym.make, or wrap it in gymnasium.wrappers.TimeLimit")
    episodes = checked_type("env", env.unwrapped, TendonRodEnv, "made by gym.make('TendonRod-TipPose-v0')").episodes
    observation, info = env.reset(seed=seed)
    log = _Log(episodes, 0, seed)
    state, begins = None, np.ones(1, dtype=bool)
    while not log.ended:
        started = time.perf_counter()
        action, state = policy.predict(observation, state, begins, deterministic=True)
        seconds = time.perf_counter() - started + episodes.model_seconds[0]
        begins = np.zeros(1, dtype=bool)
        violation = asks_too_much(action, state, episodes.limits)
        observation, reward, terminated, truncated, info = env.step(action)
        log.append(float(reward), violation, seconds, terminated or truncated)
    return log.episode()


def run_rows(policy: Policy, envs: gym.vector.VectorEnv[Any, Any, Any], seeds: Sequence[int]) -> list[Episode]:
    """Live through an episode per row. Raises TypeError; ValueError unless there is a row per seed, "next_step", and an end of episodes."""
    inner = checked_type("envs", envs.unwrapped, TendonRodVectorEnv, "made by gym.make_vec('TendonRod-TipPose-v0', num_envs=...)")
    if len(seeds) != envs.num_envs:
        raise ValueError(f"seeds should be one for each of the {envs.num_envs} rows, not {len(seeds)}")
    if envs.metadata["autoreset_mode"] is not AutoresetMode.NEXT_STEP or inner.max_episode_steps is None:
        raise ValueError("envs should be made with autoreset_mode='next_step' and with max_episode_steps: rows stay as they ended")
    observation, _ = envs.reset(seed=list(seeds))  # type: ignore[arg-type] # an int means others
    logs = [_Log(inner.episodes, row, seed) for row, seed in enumerate(seeds)]
    state, begins = None, np.ones(len(logs), dtype=bool)
    while not all(log.ended for log in logs):
        started = time.perf_counter()
        actions, state = policy.predict(observation, state, begins, deterministic=True)
        seconds = (time.perf_counter() - started) / len(logs) + inner.episodes.model_seconds
        memories = state if isinstance(state, tuple) and len(state) == len(logs) else (None,) * len(logs)
        violations = [asks_too_much(action, (memory,), inner.episodes.limits) for action, memory in zip(actions, memories, strict=True)]
        observation, rewards, terminated, truncated, _ = envs.step(actions)
        begins = terminated | truncated
        for row, log in enumerate(logs):
            if not log.ended:
                log.append(float(rewards[row]), violations[row], float(seconds[row]), bool(begins[row]))
    return [log.episode() for log in logs]


class _Log:
    """What happens in the episode of a row, from its reset on."""

    def __init__(self, episodes: Episodes, row: int, seed: int) -> None:
        self._episodes, self._row, self._seed = episodes, row, seed
        self._errors: dict[str, list[float]] = {name: [] for name in episodes.errors}
        self._tensions: list[Array] = []
        self._rewards: list[float] = []
        self._violations: list[bool] = []
        self._seconds: list[float] = []
        self.ended = False
        self._look()

    def append(self, reward: float, violation: bool, seconds: float, ended: bool) -> None:
        """Take a step's outcome, and where the row stands after it."""
        self._rewards.append(reward)
        self._violations.append(violation)
        self._seconds.append(seconds)
        self.ended = ended
        self._look()
        if ended:
            diverged = bool(self._episodes.diverged[self._row])
            self._cause = self._episodes.cause(self._row) if diverged else None
            close = self._episodes.task.goal and self._episodes.errors["position_error"][self._row] <= self._episodes.options.threshold
            self._reached = bool(close and not diverged) if self._episodes.task.goal else None  # truly, whatever its sensors say

    def _look(self) -> None:
        for name, values in self._errors.items():
            values.append(float(self._episodes.errors[name][self._row]))
        self._tensions.append(self._episodes.tension[self._row])

    def episode(self) -> Episode:
        """All of it, once it has ended."""
        return Episode(
            seed=self._seed,
            period=self._episodes.period,
            length=self._episodes.model.length,
            errors={name: np.array(values) for name, values in self._errors.items()},
            reward=np.array(self._rewards),
            tension=np.array(self._tensions),
            violation=np.array(self._violations),
            seconds=np.array(self._seconds),
            reached=self._reached,
            cause=self._cause,
        )


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
