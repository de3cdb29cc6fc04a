"""Check of exported agents: their commands beside those of the original, on observations recorded while the original acts."""

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
from soft_tendon_env.export.agent import METADATA
from soft_tendon_env.export.measurements import measurements
from soft_tendon_env.policies.protocol import Policy
from soft_tendon_env.tools.types import Array

SEEDS, STEPS = EVALUATION_SEEDS[:4], 250  # 1,000 observations
ALLOWED = 1e-4
"""Difference of commands, as a share of their range, beyond which it is no round-off of a network in single precision."""
KINDS = {"tensor(float)": np.float32, "tensor(double)": np.float64}


class Recorded(NamedTuple):
    """A control period of the original: measurements by name, the command (n_a,) that it asked for, and the time that it took [s]."""

    begins: bool
    measured: dict[str, Array]
    command: Array
    seconds: float


def record(policy: Policy, env: gym.Env[Any, Any], seeds: Sequence[int] = SEEDS, steps: int = STEPS) -> list[Recorded]:
    """Control periods of a policy that acts: `steps` of an episode from each seed."""
    episodes, found = episodes_of(env), list[Recorded]()
    inputs = measurements(episodes)
    for seed in seeds:
        before: dict[str, Array] = {}
        for k, step in enumerate(play_steps(policy, env, [seed])):
            if k:
                found.append(Recorded(k == 1, before, episodes.actuation.command[0].copy(), step.seconds))
            before = {name: np.array(of.value(episodes.observed, 0), dtype=np.float64) for name, of in inputs.items()}
            if k == steps or bool(step.ended[0]):
                break
    return found


class Agent:
    """An exported agent that onnxruntime computes on one thread, and that remembers what it needs from one call to the next.

    Attributes:
        states: what is remembered, by name; `command` is what was sent last: replace it where something else was sent.
        metadata: table of inputs, units, rate, limits and origin.
    """

    def __init__(self, path: str | Path) -> None:
        options = onnxruntime.SessionOptions()
        options.intra_op_num_threads = 1
        self._session = onnxruntime.InferenceSession(str(path), options, ["CPUExecutionProvider"])
        self._names = [output.name for output in self._session.get_outputs()]
        self.metadata = json.loads(self._session.get_modelmeta().custom_metadata_map[METADATA])
        self.reset()

    def reset(self) -> None:
        """Begin an episode: what was remembered is forgotten."""
        inputs = [of for of in self._session.get_inputs() if f"next_{of.name}" in self._names]
        self.states = {of.name: np.zeros(of.shape, KINDS[of.type]) for of in inputs}

    def __call__(self, **measured: Array) -> Array:
        """Command (n_a,) to be sent, for measurements by name."""
        found = dict(zip(self._names, self._session.run(self._names, {**measured, **self.states}), strict=True))
        self.states = {name: found[f"next_{name}"] for name in self.states}
        return found["next_command"]


class Comparison(NamedTuple):
    """Largest difference of commands, in their unit, as a share of their range and of what an action changes at most; median time [s]."""

    command: float
    of_range: float
    of_action: float
    seconds: float


def compare(agent: Agent, recorded: Sequence[Recorded]) -> Comparison:
    """Difference of an agent from what was recorded, each command after the one that was recorded before."""
    table = agent.metadata["command"]
    reach = np.subtract(table["greatest"], table["least"])
    largest = 0.5 * reach if table["increment"] is None else np.array(table["increment"])
    difference, seconds = np.zeros_like(reach), []
    for k, period in enumerate(recorded):
        if period.begins:
            agent.reset()
        else:
            agent.states["command"] = recorded[k - 1].command
        started = time.perf_counter()
        found = agent(**period.measured)
        seconds.append(time.perf_counter() - started)
        difference = np.maximum(difference, np.abs(found - period.command))
    command, of_range, of_action = (float(np.max(difference / unit)) for unit in (1.0, reach, largest))
    return Comparison(command, of_range, of_action, float(np.median(seconds)))
