"""What is said of agents: how they were trained, and how long an action takes them.

A file that names an algorithm says nothing of how little it did, and what an observation computes on the model is hidden in `step`.
"""

import time

import gymnasium as gym
import numpy as np

from soft_tendon_env.envs.courses import InverseStatics
from soft_tendon_env.evaluation import evaluate, evaluate_rows, summarise
from soft_tendon_env.policies.agent_files import AgentConfig
from soft_tendon_env.policies.trained_by import words

ROLLOUTS = {"n_steps": 16, "batch_size": 200, "n_epochs": 3}
PLANS = {"steps": 9000, "teacher": "predictive"}
ALGORITHMS = [
    ({}, "PPO for a number of steps that is not known"),
    ({"steps_done": 2560}, "PPO for 2,560 steps"),
    ({"steps_done": 2560, "arms": 20, "hyperparameters": ROLLOUTS}, "PPO for 2,560 steps (at most 48 gradient steps)"),
    ({"imitation": {"steps": 9000}, "steps_done": 0}, "imitation of tracking (DAgger, 9,000 expert labels)"),
    ({"algorithm": "DAgger", "steps_done": 9000}, "imitation of tracking (DAgger, 9,000 expert labels)"),
    ({"algorithm": "DAgger", "steps_done": 10, "hyperparameters": PLANS}, "imitation of predictive (DAgger, 10 expert labels)"),
    (
        {"imitation": PLANS, "steps_done": 16, "arms": 1, "hyperparameters": {**ROLLOUTS, "n_epochs": 1}},
        "imitation of predictive (DAgger, 9,000 expert labels), then PPO for 16 steps (at most 1 gradient step)",
    ),
    ({"start_from": "runs/first", "steps_done": 7}, "from the agent runs/first, then PPO for 7 steps"),
    (
        {"imitation": {"steps": 10, "critic_steps": 500}, "steps_done": 300},
        "imitation of tracking (DAgger, 10 expert labels), then PPO for 300 steps (the first 300 for the critic alone)",
    ),
]


class Still:
    """A policy that costs nothing."""

    def predict(self, observation, state=None, episode_start=None, deterministic=True):
        return np.zeros((*observation.shape[:-1], 3), dtype=np.float32), None


def test_how_an_agent_was_trained():
    """An imitation whose configuration names PPO, with no step of it, with a single gradient step, with the critic's steps alone.
    Expected: every part is named, with its number of steps, from the configuration alone.
    """
    assert [words(AgentConfig(**config), config.get("algorithm", "PPO")) for config, _ in ALGORITHMS] == [said for _, said in ALGORITHMS]


def test_time_of_an_action_that_observes_inverse_statics(measured, monkeypatch):
    """Inverse statics of the target are computed within `step`, many poses ahead: the policy that needs them is told as faster than it is.
    Expected: the time of an action has that of the statics of a pose, in single and vector environments; without the group it has none.
    """
    spent, of_poses = [], InverseStatics.coordinates

    def timed(self, row, poses):
        started = time.perf_counter()
        found = of_poses(self, row, poses)
        spent.append((time.perf_counter() - started) / len(poses))
        return found

    monkeypatch.setattr(InverseStatics, "coordinates", timed)
    options = {"scene": "three_tendon", "fidelity": "fast", "max_episode_steps": 12}
    means = {}
    for name, groups in (("with", ["tip_position", "inverse_statics"]), ("without", ["tip_position", "target_error"])):
        with gym.make("TendonRod-TipPose-v0", observation=groups, **options) as env:
            means[name] = evaluate(Still(), env, [5], skip=0.1)[0].action_time.median
    shares = spent[1:]  # the first call of `predict` counts nowhere
    envs = gym.make_vec("TendonRod-TipPose-v0", num_envs=2, observation=["tip_position", "inverse_statics"], **options)
    of_rows = summarise(evaluate_rows(Still(), envs, [5, 6], skip=0.1)).action_time
    envs.close()
    assert 0.9 * min(shares) < means["with"] - means["without"] < 1.2 * max(spent)
    assert 0.9 * min(spent) < of_rows.median < 1.2 * max(spent)
    measured("inverse statics of a pose [ms]", 1e3 * float(np.mean(shares)))
    measured("the rest of an action [ms]", 1e3 * float(means["without"]))
