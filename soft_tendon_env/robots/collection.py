"""Collection of motions of a robot for identification: step responses, drawn within the limits.

A motion begins at rest. Holds of drawn commands follow each other, and every few of them the
tendons are released to the first command: steps up show stiffness, delay and friction, releases
the damping and the frequency of the swing that follows.
"""

from collections.abc import Sequence
from typing import Any

import gymnasium as gym
import numpy as np

from soft_tendon_env.envs import IDS
from soft_tendon_env.envs.episodes import Episodes, episodes_of
from soft_tendon_env.robots.environment import RobotEnv
from soft_tendon_env.robots.safety import RobotStopped
from soft_tendon_env.robots.top_speed import half_swing
from soft_tendon_env.tools.types import Array

HOLDS_TO_RELEASE = 2
"""Holds after which the tendons are released: of more, each release follows fewer of them."""

HALF_SWINGS = 2.0
"""Time of a hold in half periods of the slowest vibration: a whole swing shows its damping, also of
an arm that is half as stiff as its drawing."""


def collecting_env(scene: Any, fidelity: str | None, period: float) -> gym.Env[Any, Any]:
    """Environment of an arm whose actions are commands, and whose one sensor is the tip's tracker.

    Args:
        scene: option of environments.
        fidelity: option of environments.
        period: of control [s].

    Returns:
        The environment, without an end of its episodes.

    Raises:
        ConfigurationError: for options that no environment takes.
    """
    return gym.make(
        IDS["Reach"],
        max_episode_steps=-1,  # none, in the words of Gymnasium
        scene=scene,
        fidelity=fidelity,
        control_period=period,
        action="tension",
        observation=("tip_position",),
    )


def usual_hold(episodes: Episodes) -> float:
    """Time [s] of a hold in which an arm swings once, at least a control period."""
    return max(HALF_SWINGS * half_swing(episodes), episodes.period)


def drawn_commands(
    episodes: Episodes, motions: int, holds: int, share: float, random: np.random.Generator
) -> list[Array]:
    """Commands of motions: stratified draws within the limits, with releases between them.

    Each tendon pulls once in each of as many equal parts of its range as there are holds.

    Args:
        episodes: of the arm.
        motions: number of them.
        holds: in a motion.
        share: of the range from the first command to the greatest one.
        random: generator of the draws.

    Returns:
        Commands (holds and releases, n_a) of each motion, in the unit of the arm.
    """
    rest = episodes.start_command
    way = share * (episodes.actuation.actions.greatest - rest)
    total = motions * holds
    parts = _stratified(total, rest.size, random)
    commands = rest + parts * way
    return [_with_releases(part, rest) for part in np.split(commands, motions)]


def _stratified(count: int, columns: int, random: np.random.Generator) -> Array:
    """Latin hypercube sample (count, columns): of a column, one number in each of `count` parts."""
    strata = np.empty((count, columns))
    for column in range(columns):
        strata[:, column] = random.permutation(count)
    within = random.uniform(size=strata.shape)
    return (strata + within) / count


def _with_releases(commands: Array, rest: Array) -> Array:
    """Commands of holds (holds, n_a) with releases to `rest` (n_a,) between and after them."""
    rows = list[Array]()
    for k, command in enumerate(commands, start=1):
        rows.append(command)
        is_last = k == len(commands)
        if is_last or k % HOLDS_TO_RELEASE == 0:
            rows.append(rest)
    return np.array(rows)


def collect(env: RobotEnv, motions: Sequence[Array], hold: float) -> None:
    """Plays commands on a robot, each motion from rest, and lets the tendons go at the end.

    Args:
        env: of `collecting_env`, with a log that gets the motions.
        motions: commands (rows, n_a) of each.
        hold: time [s] for which each command is held, rounded to control periods.

    Raises:
        RobotStopped: where the robot is stopped before the end.
    """
    episodes = episodes_of(env)
    actions = episodes.actuation.actions
    span = actions.greatest - actions.least
    periods = round(hold / episodes.period)
    try:
        for commands in motions:
            env.reset(seed=0)
            parts = (commands - actions.least) / span
            for action in 2.0 * parts - 1.0:
                for _ in range(periods):
                    _, _, _, truncated, info = env.step(action)
                    if truncated:
                        raise RobotStopped(info["stopped"])
    finally:
        env.close()
