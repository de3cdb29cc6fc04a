"""Robot behind the Gymnasium interface of a simulated arm: same observation and action spaces, rewards and info.

    env = RobotEnv(gym.make("TendonRod-Reach-v0", scene="my_arm.toml", observation="measurable", sensors=3), MyRobot())

Policies and Stable-Baselines3 run on it as they are. A step lasts a control period, to its absolute deadline.
"""

from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
from gymnasium.error import ResetNeeded
from numpy.typing import ArrayLike

from soft_tendon_env.envs.single import TendonRodEnv
from soft_tendon_env.robots.clock import Timing
from soft_tendon_env.robots.log import RobotLog
from soft_tendon_env.robots.measured_arm import MeasuredArm, misfit
from soft_tendon_env.robots.protocol import Robot, check_robot
from soft_tendon_env.robots.safety import RobotStopped, SafeRobot, Stop
from soft_tendon_env.tools.checks import checked_count, checked_number, checked_type
from soft_tendon_env.tools.configuration import ConfigurationError, Problem
from soft_tendon_env.tools.types import Array

SETTLE = 1.0  # [s] in which an arm is brought to where episodes begin
PATIENCE = 3  # control periods without a new reading, or behind the deadlines, after which an arm is let go
REST_SPEED = 0.005  # of the tip at rest, in lengths of the arm per second


class RobotEnv(gym.Wrapper[Any, Any, Any, Any]):
    """A robot in place of the simulated arm of an environment with one arm, made by `gym.make`.

    `reset` brings the robot from slack tendons to the first command, the pretension, within `settle` [s], waits until it is at rest, and
    makes what it then measures the zero of tendon lengths and strains. Commands stay within the environment's limits, and change
    by at most `rate` [N/s, or m/s] where that is given. After `patience` periods without a new reading or behind the deadlines, a tip where
    the arm cannot be, or an error of the robot, the tendons are slack within RAMP and the episode is truncated, `info["stopped"]` says why;
    `reset` begins again. `close` lets the tendons go and closes the robot.

    Args:
        env: what it observes and how actions are read; its options say the scene, `control_period` and `tension_limits`.
        robot: see Robot.
        settle: 0 for one that is at rest where episodes begin when the first one does, and whose sensors have their zeros.
        rest_speed: greatest speed of the tip at rest, root mean square, in lengths of the arm per second.
        log: new CSV file of the periods, see log.py; None: none. A file that is there is not overwritten.

    Raises ConfigurationError where the robot does not fit the environment, TypeError, ValueError, OSError.
    """

    def __init__(
        self,
        env: gym.Env[Any, Any],
        robot: Robot,
        *,
        rate: float | None = None,
        settle: float = SETTLE,
        rest_speed: float = REST_SPEED,
        patience: int = PATIENCE,
        log: str | Path | None = None,
    ) -> None:
        super().__init__(env)
        inner = checked_type("env", env.unwrapped, TendonRodEnv, "made by gym.make('TendonRod-TipPose-v0')")
        check_robot(robot)
        self.robot, episodes = robot, inner.episodes
        if reason := misfit(robot, episodes):
            raise ConfigurationError([Problem(("robot",), f"is {type(robot).__name__}, {reason}")], "environment")
        limits = np.stack([episodes.actions.least, episodes.actions.greatest], axis=1)
        fastest = np.inf if rate is None else checked_number("rate", rate, 1e-9, "a positive number, or None")
        rise = checked_number("settle", settle, 0.0, "a number of seconds, at least 0")
        still = checked_number("rest_speed", rest_speed, 1e-9, "a positive number of lengths per second") * episodes.model.length
        sensors, length = episodes.sensors.size, np.inf if episodes.model.scene.effects.moving_base is not None else episodes.model.length
        self._safe = SafeRobot(robot, limits, sensors, length, episodes.period, fastest, checked_count("patience", patience, 1))
        self._log = None if log is None else RobotLog(Path(log), robot.command_unit, self._safe.senses, len(limits), sensors)
        # the pretension is not there before the rate has led to it
        rise = max(rise, float(np.abs(episodes.start_command - self._safe.slack).max()) / fastest)
        self._arm = MeasuredArm(episodes, self._safe, settle == 0.0, rise, still, self._log)
        self._last: Any = None
        episodes.attach(self._arm)

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Any, dict[str, Any]]:
        """A new episode, which begins with the robot at rest. Raises RobotStopped where it does not come to that."""
        self._last = self.env.reset(seed=seed, options=options)
        return self._last

    def step(self, action: ArrayLike) -> tuple[Any, float, bool, bool, dict[str, Any]]:
        """One control period; a robot that is stopped truncates the episode, with the last observation and reward 0. Raises as the
        environment for actions of wrong shape or with NaN, ResetNeeded."""
        if self._last is None:
            raise ResetNeeded("step was called before reset")
        try:
            observation, reward, terminated, truncated, info = self.env.step(action)
        except RobotStopped as stopped:
            observation, info = self._last
            return observation, 0.0, False, True, {**info, "stopped": str(stopped)}
        self._last = observation, info
        return observation, float(reward), terminated, truncated, info

    @property
    def timing(self) -> Timing:
        """Statistics of the control periods since the last reset."""
        return self._arm.pacer.timing

    @property
    def zero(self) -> dict[str, Array]:
        """Zeros found by the last reset, added to what the robot measures: tendon_length (n_a,) [m], strain (s, 6)."""
        return self._arm.zero

    @property
    def stopped(self) -> Stop | None:
        """Course of the last stop; None while the robot runs."""
        return self._safe.stopped

    def stop(self, cause: str) -> Stop:
        """Lets the tendons go, from any thread, and waits until they are slack."""
        return self._safe.stop(cause)

    def close(self) -> None:
        """Lets the tendons go, closes the robot, and completes the log."""
        try:
            self._safe.close()
        finally:
            if self._log is not None:
                self._log.close()
            super().close()


def robot_of(env: gym.Env[Any, Any]) -> RobotEnv:
    """The RobotEnv within wrappers. Raises TypeError."""
    while isinstance(env, gym.Wrapper):
        if isinstance(env, RobotEnv):
            return env
        env = env.env
    raise TypeError("env should be a RobotEnv, alone or wrapped")
