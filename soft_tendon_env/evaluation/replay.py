"""Replay of episodes: their actions alone give the same numbers bit for bit, unless the policy did more than act."""

from collections.abc import Sequence

import numpy as np
from gymnasium.utils import seeding

from soft_tendon_env.envs import Options
from soft_tendon_env.envs.episodes import Episodes
from soft_tendon_env.envs.tasks import Task
from soft_tendon_env.evaluation.metrics import Episode
from soft_tendon_env.policies.own_policy import EntrantError
from soft_tendon_env.tools.types import Array


def check_replayed(policy: str, task: Task, options: Options, found: Sequence[Episode], actions: Sequence[Array]) -> None:
    """Raises EntrantError unless the actions (rows, n_a) of a policy alone give the errors, tensions, rewards and ends of its episodes, one
    to a row."""
    fresh, steps = Episodes(task, options, len(found), 1), np.array([len(episode.reward) for episode in found])
    fresh.begin(np.arange(len(found)), [seeding.np_random(episode.seed)[0] for episode in found])
    for k in range(1 + steps.max()):
        if k:
            fresh.step(actions[k - 1], np.flatnonzero(steps >= k))
        for row in map(int, np.flatnonzero(steps >= k)):
            played, again = found[row], {name: float(error[row]) for name, error in fresh.errors.items()}
            same = {name: error[k] for name, error in played.errors.items()} == again
            same &= np.array_equal(played.tension[k], fresh.tension[row]) and (not k or played.reward[k - 1] == fresh.reward[row])
            if k == steps[row]:
                same &= (played.cause is not None, played.reached) == (bool(fresh.diverged[row]), reached_goal(fresh, row))
            if not same:
                said = f"its actions alone give other numbers at {k * played.period:g} s of the episode of seed {played.seed}"
                raise EntrantError(policy, f"which reached into the environment that it was judged in: {said}")


def reached_goal(episodes: Episodes, row: int) -> bool | None:
    """Whether a row is truly at its goal, whatever its sensors say; None where there is none."""
    if not episodes.task.goal:
        return None
    return bool(episodes.errors["position_error"][row] <= episodes.options.threshold and not episodes.diverged[row])
