"""Replayable files of diverged episodes: generator state and options at reset, and every action up to the one that failed."""

import json
import tempfile
from pathlib import Path
from typing import Any, NamedTuple

import gymnasium as gym
import numpy as np
from numpy.typing import NDArray

from soft_tendon_env.model.state import State
from soft_tendon_env.tools.configuration import ConfigurationError, Problem, not_among, plain
from soft_tendon_env.tools.files import parse_json, read_arrays

EPISODE = "diverged episode"


class DivergenceLog:
    """Rows of episodes as they go on; `write` makes a file of one."""

    def __init__(self, folder: str, task: str, options: dict[str, Any], rows: int) -> None:
        """Makes the folder. Raises ConfigurationError where that fails."""
        self._folder, self._task, self._options = Path(folder), task, plain(options)
        try:
            self._folder.mkdir(parents=True, exist_ok=True)
            tempfile.TemporaryFile(dir=self._folder).close()
        except OSError as error:
            text = f"is {folder!r}: it should be a folder that can be written to: {error.strerror}"
            raise ConfigurationError([Problem(("divergence_folder",), text)], "environment") from error
        self._begun: list[dict[str, Any]] = [{} for _ in range(rows)]
        self._actions: list[list[NDArray[np.float64]]] = [[] for _ in range(rows)]

    def begin(self, row: int, generator: np.random.Generator) -> None:
        """A new episode, before anything is drawn from its generator."""
        self._begun[row], self._actions[row] = dict(generator.bit_generator.state), []

    def append(self, row: int, action: NDArray[np.float64]) -> None:
        """An action (n_a,) that is about to be taken."""
        self._actions[row].append(action.copy())

    def write(self, row: int, cause: str, state: State) -> Path:
        """Write an episode that has just diverged, to a new file."""
        self._folder.mkdir(parents=True, exist_ok=True)  # again, should someone have tidied up
        last: dict[str, Any] = {"time": state.time, "q": state.q, "q_dot": state.q_dot}
        content = {"task": self._task, "options": self._options, "generator": self._begun[row], "cause": cause}
        for number in range(1_000_000):
            path = self._folder / f"{self._task}-divergence-{number:03d}.npz"
            try:
                with open(path, "xb") as file:
                    np.savez(file, episode=json.dumps(content), actions=np.array(self._actions[row]), **last)
                return path
            except FileExistsError:
                continue
        raise FileExistsError(f"{self._folder} is full of divergence files")


class Replay(NamedTuple):
    """A diverged episode replayed: the environment as it is now, the last observation and info, and the recorded cause."""

    env: gym.Env[Any, Any]
    observation: Any
    info: dict[str, Any]
    cause: str


def replay_divergence(path: str | Path) -> Replay:
    """Replay an episode that `divergence_folder` kept, up to its divergence. Raises OSError or ValueError."""
    from soft_tendon_env.envs.single import environment_class  # which in turn writes these files
    from soft_tendon_env.envs.tasks import TASKS

    saved = read_arrays(path, ("actions", "episode"), EPISODE)
    try:
        content = parse_json(str(saved["episode"]))
        make, options, generator, cause = (content[key] for key in ("task", "options", "generator", "cause"))
        if make not in TASKS:
            raise ValueError(f"its task is {make!r}: {not_among(str(make), TASKS)}; import the module that registers it")
        env = environment_class(TASKS[make])(**{**options, "divergence_folder": None, "on_divergence": "terminate"})
        env.np_random.bit_generator.state = generator
    except (TypeError, LookupError, ValueError) as error:
        raise ValueError(f"{path} holds no {EPISODE}: {error}") from error
    observation, info = env.reset()
    for action in saved["actions"]:
        observation, _, _, _, info = env.step(action)
    return Replay(env, observation, info, cause)
