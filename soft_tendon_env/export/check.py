"""Check of exported agents: their commands beside those of the original, on what is measured while the original acts."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

import gymnasium as gym
import numpy as np
import onnxruntime

from soft_tendon_env.envs.episodes import episodes_of
from soft_tendon_env.evaluation.conditions import EVALUATION_SEEDS
from soft_tendon_env.evaluation.play import play_steps
from soft_tendon_env.export.agent import measurements
from soft_tendon_env.policies.protocol import Policy
from soft_tendon_env.tools.types import Array

SEEDS, STEPS = EVALUATION_SEEDS[:4], 250  # 1,000 observations
ALLOWED = 1e-4
"""Difference of commands, as a share of their range, beyond which it is no round-off of a network in single precision."""


class Comparison(NamedTuple):
    """Number of observations; largest difference of commands on them, in their unit and as a share of their range."""

    observations: int
    command: float
    of_range: float


def compare(path: Path, policy: Policy, env: gym.Env[Any, Any], seeds: Sequence[int] = SEEDS, steps: int = STEPS) -> Comparison:
    """Difference of an exported agent from its original, which acts for `steps` control periods of an episode from each seed.

    The agent remembers as command what the original has sent.
    """
    episodes, session = episodes_of(env), onnxruntime.InferenceSession(str(path), providers=["CPUExecutionProvider"])
    names, inputs = [of.name for of in session.get_outputs()], {of.name: np.zeros(of.shape) for of in session.get_inputs()}
    found = list[Array]()
    for seed in seeds:
        after = dict[str, Array]()
        for k, step in enumerate(play_steps(policy, env, [seed])):
            if k:
                sent = episodes.actuation.command[0].copy()
                found.append(np.abs(after["next_command"] - sent))
                after["next_command"] = sent
            if k == steps or step.ended[0]:
                break
            known = measurements(episodes) | {name.removeprefix("next_"): value for name, value in after.items()}
            given = {name: known.get(name, none) for name, none in inputs.items()}
            after = dict(zip(names, session.run(names, given), strict=True))
    actions, largest = episodes.actuation.actions, np.max(found, axis=0)
    return Comparison(len(found), float(largest.max()), float((largest / (actions.greatest - actions.least)).max()))
