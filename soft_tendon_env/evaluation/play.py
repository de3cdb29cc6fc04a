"""Episodes of any policy, played by one loop of `predict` and `step`.

It plays one arm at a time, or many side by side as rows.

    scores = evaluate(policy, env, EVALUATION_SEEDS)
    print(summarise(scores).errors["position_error"].rms)

A policy is whatever has Stable-Baselines3's `predict`. Errors are the true ones, whatever the
sensors say; see metrics.py.
"""

import time
from collections.abc import Iterable, Iterator, Sequence
from typing import Any, NamedTuple

import gymnasium as gym
import numpy as np
from gymnasium.vector import AutoresetMode
from numpy.typing import NDArray

from soft_tendon_env.envs.environments import TendonRodEnv, TendonRodVectorEnv
from soft_tendon_env.envs.episodes import episodes_of
from soft_tendon_env.evaluation.metrics import Episode, EpisodeScore, score
from soft_tendon_env.policies.protocol import Policy
from soft_tendon_env.tools.checks import checked_type
from soft_tendon_env.tools.types import Array

STILL = 1e-9
"""Greatest change of a target's pose [m, or of its rotation's entries] in a control period of a
target that holds still."""
Env = gym.Env[Any, Any] | gym.vector.VectorEnv[Any, Any, Any]


def evaluate(
    policy: Policy,
    env: gym.Env[Any, Any],
    seeds: Iterable[int],
    skip: float = 1.0,
) -> list[EpisodeScore]:
    """Scores a policy on one episode per seed.

    Args:
        policy: with `predict` as of Stable-Baselines3.
        env: environment with one arm of this package, whose episodes end.
        seeds: of `reset`.
        skip: time [s] from which on errors count.

    Returns:
        Scores in the order of the seeds.

    Raises:
        TypeError: for environments of other packages.
        ValueError: for episodes that end before `skip` or have no end.
    """
    if isinstance(env, TendonRodEnv):
        raise ValueError(
            "env should end its episodes: make it with gym.make, or wrap it in"
            " gymnasium.wrappers.TimeLimit"
        )
    checked_type("env", env.unwrapped, TendonRodEnv, "made by gym.make('TendonRod-TipPose-v0')")
    return [score(episode, skip) for seed in seeds for episode in play(policy, env, [seed])]


def evaluate_rows(
    policy: Policy,
    envs: gym.vector.VectorEnv[Any, Any, Any],
    seeds: Sequence[int],
    skip: float = 1.0,
) -> list[EpisodeScore]:
    """Scores a policy on episodes side by side, as `evaluate` does.

    Row i of a vector environment plays the episode of seeds[i]. The time of an action is that of
    all rows divided by their number.

    Args:
        policy: with `predict` as of Stable-Baselines3.
        envs: vector environment of this package with a step limit and `autoreset_mode="next_step"`.
        seeds: of `reset`, one per row.
        skip: time [s] from which on errors count.

    Returns:
        Scores in the order of the seeds.

    Raises:
        TypeError: for environments of other packages.
        ValueError: for another number of seeds, another reset mode, or episodes that end before
            `skip` or have no end.
    """
    inner = checked_type(
        "envs",
        envs.unwrapped,
        TendonRodVectorEnv,
        "made by gym.make_vec('TendonRod-TipPose-v0', num_envs=...)",
    )
    if len(seeds) != envs.num_envs:
        raise ValueError(
            f"seeds should be one for each of the {envs.num_envs} rows, not {len(seeds)}"
        )
    if (
        envs.metadata["autoreset_mode"] is not AutoresetMode.NEXT_STEP
        or inner.max_episode_steps is None
    ):
        raise ValueError(
            "envs should be made with autoreset_mode='next_step' and with max_episode_steps: rows"
            " stay as they ended"
        )
    return [score(episode, skip) for episode in play(policy, envs, seeds)]


class Step(NamedTuple):
    """One control period of all rows.

    It has rewards (rows,), rows that ended (rows,), and the time [s] that each action took.
    """

    reward: Array
    ended: NDArray[np.bool_]
    seconds: float


def play_steps(
    policy: Policy,
    env: Env,
    seeds: Sequence[int],
) -> Iterator[Step]:
    """Steps of an episode per seed, without end: the reset comes first, with zeros.

    A vector environment has a row per seed, any other one seed. `env` stands where the step left it
    when a step is yielded.
    """
    rows = len(seeds)
    # of an int Gymnasium would make the seeds of rows itself
    if isinstance(env, gym.vector.VectorEnv):
        seed: Any = list(seeds)
    else:
        seed = seeds[0]
    observation, _ = env.reset(seed=seed)
    state = None
    ended = np.ones(rows, dtype=bool)
    yield Step(np.zeros(rows), np.zeros(rows, dtype=bool), 0.0)
    while True:
        started = time.perf_counter()
        action, state = policy.predict(observation, state, ended, deterministic=True)
        seconds = (time.perf_counter() - started) / rows
        observation, reward, terminated, truncated, _ = env.step(action)
        is_over = np.logical_or(terminated, truncated)
        ended = np.atleast_1d(is_over)
        reward_row = np.asarray(reward, dtype=float)
        yield Step(np.atleast_1d(reward_row), ended, seconds)


def play(
    policy: Policy,
    env: Env,
    seeds: Sequence[int],
) -> list[Episode]:
    """Episodes of these seeds, played to their ends; a row that ends waits for the others."""
    episodes = episodes_of(env)
    rows = len(seeds)
    # reward, seconds, target, tip, tension, errors of all rows, after every step
    course: list[tuple[Array, ...]] = []
    ends: dict[int, dict[str, Any]] = {}
    for k, step in enumerate(play_steps(policy, env, seeds)):
        # the next step overwrites what the environment has now
        sample = (
            step.reward,
            np.full(rows, step.seconds),
            episodes.target_pose.copy(),
            episodes.arms.reading.tip_pose[:, :3, 3].copy(),
            episodes.tension.copy(),
            np.array([*episodes.errors.values()]).T,
        )
        course.append(sample)
        ended_rows = map(int, np.flatnonzero(step.ended))
        for row in ended_rows:
            cause = None
            if episodes.diverged[row]:
                cause = episodes.cause(row)
            reached = None
            # an episode that diverged did not reach its goal, wherever the tip was
            if episodes.task.goal:
                error = episodes.errors["position_error"][row]
                reached = cause is None and bool(error <= episodes.threshold)
            ends.setdefault(row, {"steps": k, "cause": cause, "reached": reached})
        if len(ends) == rows:
            break

    def episode(row: int, seed: int, steps: int, **end: Any) -> Episode:
        samples = course[: steps + 1]
        columns = zip(*samples, strict=True)
        reward, seconds, target, tip, tension, errors = (
            np.array([values[row] for values in column]) for column in columns
        )
        # the target's changes in the last two steps: still, then a jump
        last_targets = target[-3:]
        steps_of_target = np.diff(last_targets, axis=0)
        changes = np.abs(steps_of_target)
        moves = (changes > STILL).any(axis=(1, 2))
        return Episode(
            seed,
            episodes.period,
            episodes.model.length,
            dict(zip(episodes.errors, errors.T.copy(), strict=True)),
            reward[1:],
            tension,
            tip,
            target[:, :3, 3],
            seconds[1:],
            jumped=moves.tolist() == [False, True],
            **end,
        )

    return [episode(row, seed, **ends[row]) for row, seed in enumerate(seeds)]
