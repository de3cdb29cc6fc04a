"""Environments with many arms for Stable-Baselines3.

It has no adapter of its own for Gymnasium's vector environments.

    from soft_tendon_env.learning.vec_env import make_sb3_vec_env
    agent = PPO("MlpPolicy", make_sb3_vec_env("TendonRod-TipPose-v0", 64, fidelity="fast"))

Nothing else of the package imports this module, since it needs
`pip install "soft_tendon_env[agents]"`.
"""

import time
from collections.abc import Sequence
from typing import Any

import gymnasium as gym
import numpy as np
from gymnasium.vector import AutoresetMode
from numpy.typing import NDArray
from stable_baselines3.common.monitor import Monitor
from stable_baselines3.common.vec_env import VecEnv, VecEnvWrapper
from stable_baselines3.common.vec_env.base_vec_env import VecEnvIndices, VecEnvObs, VecEnvStepReturn

from soft_tendon_env.envs.environments import TendonRodVectorEnv


class StableBaselinesVecEnv(VecEnv):
    """Rows of an environment as a VecEnv of Stable-Baselines3.

    Row i is the single environment under DummyVecEnv with Monitor, bit for bit. An ended row is
    reset at once. `infos[i]` is the info of the single environment in plain floats, with
    "TimeLimit.truncated" and, at the end of an episode, "terminal_observation" and "episode":
    return "r", length "l" and seconds "t" since this object was made.

    Args:
        env: with `autoreset_mode="same_step"`.

    Raises:
        TypeError: for environments of other packages.
        ValueError: for another reset mode.
    """

    def __init__(self, env: TendonRodVectorEnv) -> None:
        """Wraps the rows."""
        if not isinstance(env, TendonRodVectorEnv):
            raise TypeError(
                "env should be a TendonRodVectorEnv, as gym.make_vec makes of this package's ids,"
                f" not {type(env).__name__}"
            )
        if env.autoreset_mode is not AutoresetMode.SAME_STEP:
            raise ValueError(
                "env should be made with autoreset_mode='same_step', not"
                f" {env.autoreset_mode.name.lower()!r}"
            )
        self.env = env
        self.spec = env.spec
        self._born = time.time()
        self._returns = np.zeros(env.num_envs)
        self._lengths = np.zeros(env.num_envs, dtype=np.int64)
        super().__init__(env.num_envs, env.single_observation_space, env.single_action_space)

    def reset(self) -> VecEnvObs:
        """New episodes of all rows.

        They have the seeds that `seed` has set, once, and the options of `reset` from
        `set_options`, likewise.
        """
        keys = set().union(*self._options)
        options = {key: [of_row.get(key) for of_row in self._options] for key in keys}
        observation, _ = self.env.reset(seed=self._seeds, options=options)
        self._reset_seeds()
        self._reset_options()
        self._returns[:] = 0.0
        self._lengths[:] = 0
        return observation

    def step_async(self, actions: NDArray[Any]) -> None:
        """Keep the actions (rows, n_a) for `step_wait`."""
        self._actions = actions

    def step_wait(self) -> VecEnvStepReturn:
        """One control period: observations, rewards (rows,) float32, dones (rows,) and infos."""
        observation, reward, terminated, truncated, info = self.env.step(self._actions)
        done = terminated | truncated
        late = truncated & ~terminated
        # quicker for all rows than to look which have ended
        infos = _of_all_rows(info, {"TimeLimit.truncated": late})
        self._returns += reward
        self._lengths += 1
        for row in np.flatnonzero(done).tolist():
            last = _of_row(info["final_info"], row)
            last["TimeLimit.truncated"] = bool(late[row])
            last["terminal_observation"] = info["final_obs"][row]
            last["episode"] = self._end_episode(row)
            infos[row] = last
        rewards = reward.astype(np.float32)
        return observation, rewards, done, infos

    def _end_episode(self, row: int) -> dict[str, float]:
        """Return, length and time of a row's episode that has ended, as Monitor has them."""
        total = float(self._returns[row])
        length = int(self._lengths[row])
        seconds = time.time() - self._born
        self._returns[row] = 0.0
        self._lengths[row] = 0
        return {"r": round(total, 6), "l": length, "t": round(seconds, 6)}

    def get_attr(self, attr_name: str, indices: VecEnvIndices = None) -> list[Any]:
        """An attribute of the environment, which the rows share, for each of `indices`.

        Spaces are those of one row.
        """
        is_space = attr_name in ("observation_space", "action_space")
        if is_space:
            name = f"single_{attr_name}"
        else:
            name = attr_name
        value = getattr(self.env, name)
        return [value for _ in self._get_indices(indices)]

    def set_attr(self, attr_name: str, value: Any, indices: VecEnvIndices = None) -> None:
        """Set an attribute of the environment.

        Raises ValueError unless `indices` are all rows, since they share it.
        """
        all_rows = set(range(self.num_envs))
        if set(self._get_indices(indices)) != all_rows:
            raise ValueError(
                f"indices should be None: the rows share {attr_name!r}, it cannot be set for some"
            )
        setattr(self.env, attr_name, value)

    def env_method(
        self,
        method_name: str,
        *method_args: Any,
        indices: VecEnvIndices = None,
        **method_kwargs: Any,
    ) -> list[Any]:
        """Results of a method of the environment, called once for each of `indices`.

        Raises ValueError for methods of all rows at once.
        """
        if method_name in ("reset", "step", "set_target", "render", "close", "close_extras"):
            raise ValueError(
                f"{method_name!r} acts on all rows at once: it cannot be called by env_method"
            )
        method = getattr(self.env, method_name)
        return [method(*method_args, **method_kwargs) for _ in self._get_indices(indices)]

    def env_is_wrapped(
        self, wrapper_class: type[gym.Wrapper[Any, Any, Any, Any]], indices: VecEnvIndices = None
    ) -> list[bool]:
        """True for Monitor, whose work is done here, else False."""
        return [wrapper_class is Monitor for _ in self._get_indices(indices)]

    def get_images(self) -> Sequence[NDArray[np.uint8] | None]:
        """A frame (height, width, 3) per row; None without a render mode."""
        pictures = self.env.render()
        return pictures or [None] * self.num_envs

    def close(self) -> None:
        """Close the environment."""
        self.env.close()


def make_sb3_vec_env(id: str, num_envs: int, **options: Any) -> StableBaselinesVecEnv:
    """Makes an environment with many rows for Stable-Baselines3.

    Args:
        id: of the environment.
        num_envs: number of rows.
        options: as for `gym.make_vec`: `max_episode_steps`, `fidelity`, `target`, ...

    Returns:
        The rows as a VecEnv.

    Raises:
        TypeError: for the id of another package's environment.
        ConfigurationError: for options that are not allowed.
    """
    env: Any = gym.make_vec(id, num_envs=num_envs, autoreset_mode="same_step", **options)
    return StableBaselinesVecEnv(env)


def unwrapped(env: VecEnv) -> StableBaselinesVecEnv:
    """Vector environment of the arms within wrappers of Stable-Baselines3.

    Raises TypeError for others than this package's.
    """
    while isinstance(env, VecEnvWrapper):
        env = env.venv
    if not isinstance(env, StableBaselinesVecEnv):
        raise TypeError(f"env is a {type(env).__name__}: it should be made by make_sb3_vec_env")
    return env


def _of_all_rows(info: dict[str, Any], more: dict[str, NDArray[Any]]) -> list[dict[str, Any]]:
    """Dictionaries of plain values, quickly and without regard to masks.

    `step_wait` replaces those of rows that have ended.
    """
    columns = {name: value for name, value in info.items() if _is_value(name)}
    columns |= more
    names = tuple(columns)
    lists = [column.tolist() for column in columns.values()]
    rows = zip(*lists, strict=True)
    return [dict(zip(names, values, strict=True)) for values in rows]


def _of_row(info: dict[str, Any], row: int) -> dict[str, Any]:
    """Info of a row, as plain values."""
    values = {}
    for name, column in info.items():
        if _is_value(name) and info[f"_{name}"][row]:
            entry = column[row : row + 1]
            plain = entry.tolist()
            values[name] = plain[0]
    return values


def _is_value(name: str) -> bool:
    """Whether a key of info has values of rows rather than a mask or what is no number."""
    return not name.startswith("_") and name not in ("drawn", "final_obs", "final_info")
