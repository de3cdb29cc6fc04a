"""Check of exported agents: their commands beside those of the original, on what is measured while the original acts."""

import json
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

import gymnasium as gym
import numpy as np
import onnxruntime

from soft_tendon_env.envs.episodes import episodes_of
from soft_tendon_env.evaluation.conditions import EVALUATION_SEEDS
from soft_tendon_env.evaluation.play import play_steps
from soft_tendon_env.export.agent import METADATA, measurements
from soft_tendon_env.policies.protocol import Policy
from soft_tendon_env.tools.types import Array

SEEDS, STEPS = EVALUATION_SEEDS[:4], 250  # 1,000 observations
ALLOWED = 1e-4
"""Difference of commands, as a share of their range, beyond which it is no round-off of a network in single precision."""


class Comparison(NamedTuple):
    """Largest difference of commands, in their unit and as a share of their range; median times [s] of an action; what the file says."""

    observations: int
    command: float
    of_range: float
    seconds: float
    original_seconds: float
    metadata: dict[str, Any]


def compare(path: Path, policy: Policy, env: gym.Env[Any, Any], seeds: Sequence[int] = SEEDS, steps: int = STEPS) -> Comparison:
    """Difference of an exported agent from its original, which acts for `steps` control periods of an episode from each seed.

    The agent runs on one thread and remembers as command what the original has sent.
    """
    options, episodes = onnxruntime.SessionOptions(), episodes_of(env)
    options.intra_op_num_threads = 1
    session = onnxruntime.InferenceSession(str(path), options, ["CPUExecutionProvider"])
    names, inputs = [of.name for of in session.get_outputs()], {of.name: np.zeros(of.shape) for of in session.get_inputs()}
    found, times, after, seconds = list[Array](), list[tuple[float, float]](), dict[str, Array](), 0.0
    for seed in seeds:
        after = {}
        for k, step in enumerate(play_steps(policy, env, [seed])):
            if k:
                sent = episodes.actuation.command[0].copy()
                found.append(np.abs(after["next_command"] - sent))
                times.append((seconds, step.seconds))
                after["next_command"] = sent
            if k == steps or step.ended[0]:
                break
            known = measurements(episodes) | {name.removeprefix("next_"): value for name, value in after.items()}
            given = {name: known.get(name, none) for name, none in inputs.items()}
            started = time.perf_counter()
            after = dict(zip(names, session.run(names, given), strict=True))
            seconds = time.perf_counter() - started
    said = json.loads(session.get_modelmeta().custom_metadata_map[METADATA])
    actions, largest = episodes.actuation.actions, np.max(found, axis=0)
    share, (taken, original) = largest / (actions.greatest - actions.least), np.median(times, axis=0).tolist()
    return Comparison(len(found), float(largest.max()), float(share.max()), taken, original, said)
