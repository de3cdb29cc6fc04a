"""Scores of the environments as their ids make them: a table of docs/reference/environments.md.

    python benchmarks/scores.py [--quick] [--out out]

Mean return of episodes of 10 s at `standard`, and mean over episodes of the RMS error after the
first second, over the evaluation seeds.
"""

from collections.abc import Sequence
from typing import Any

import gymnasium as gym
import numpy as np
from _results import markdown_table, parser_of, write_csv, write_tables
from tqdm import tqdm

from soft_tendon_env.envs import IDS
from soft_tendon_env.evaluation import EVALUATION_SEEDS, evaluate_rows
from soft_tendon_env.policies import load_policy, policy_options

PERIOD = 0.02  # [s]
SECONDS = 10.0  # length of an episode
FIDELITY = {"fidelity": "standard"}
LARGEST = {"idle": 0.0, "random": 1.0}  # action
NAMED = {
    "PPO that ships": "ppo",
    "best agent that ships": "agent",
    "MPC with the exact model": "predictive",
}


class RandomPolicy:
    """Actions from a uniform distribution."""

    def __init__(self, largest: float, actions: int) -> None:
        self.largest = largest
        self.actions = actions
        self.generator = np.random.default_rng(0)

    def predict(
        self,
        observation: Any,
        state: Any = None,
        episode_start: Any = None,
        deterministic: bool = False,
    ) -> tuple[Any, Any]:
        return self.largest * self.generator.uniform(
            -1.0, 1.0, (len(episode_start), self.actions)
        ), None


def main() -> None:
    arguments = parser_of(__doc__).parse_args()
    seeds, seconds = (EVALUATION_SEEDS[:1], 1.2) if arguments.quick else (EVALUATION_SEEDS, SECONDS)
    header = (
        "policy",
        *(f"{IDS[task]}: {what}" for task in IDS for what in ("return", "error [mm]")),
    )
    rows = [
        [policy, *(text for task in IDS for text in scores(task, policy, seeds, seconds))]
        for policy in tqdm([*LARGEST, *NAMED], leave=False)
    ]
    write_csv(arguments.out / "scores.csv", header, rows)
    write_tables(arguments.out / "scores.md", markdown_table(header, rows))


def scores(task: str, name: str, seeds: Sequence[int], seconds: float) -> tuple[str, str]:
    """Mean return and error [mm] of a policy."""
    options = policy_options(NAMED[name], task, FIDELITY) if name in NAMED else FIDELITY
    envs = gym.make_vec(
        IDS[task], num_envs=len(seeds), max_episode_steps=round(seconds / PERIOD), **options
    )
    policy = (
        load_policy(NAMED[name], envs)
        if name in NAMED
        else RandomPolicy(LARGEST[name], envs.single_action_space.shape[0])
    )
    found = evaluate_rows(policy, envs, list(seeds))
    envs.close()
    error = np.mean([next(iter(score.errors.values())).rms for score in found])
    return f"{np.mean([score.total_reward for score in found]):.3g}", f"{1e3 * error:.3g}"


if __name__ == "__main__":
    main()
