"""Robot behind the Gymnasium interface of a simulated arm, with the same observation and action spaces, and runs of policies on it.

    env = RobotEnv(gym.make("TendonRod-Reach-v0", scene="my_arm.toml", observation="measurable", sensors=3), MyRobot())

Policies and Stable-Baselines3 run on it as they are. A step lasts a control period, to its absolute deadline.
"""

from pathlib import Path
from typing import Any, NamedTuple

import gymnasium as gym
import numpy as np
from gymnasium.error import ResetNeeded
from numpy.typing import ArrayLike

from soft_tendon_env.envs.environments import TendonRodEnv
from soft_tendon_env.envs.episodes import episodes_of
from soft_tendon_env.evaluation.play import play_steps
from soft_tendon_env.policies.protocol import Policy
from soft_tendon_env.robots.clock import Timing
from soft_tendon_env.robots.log import RobotLog
from soft_tendon_env.robots.measured_arm import MeasuredArm, misfit
from soft_tendon_env.robots.protocol import Robot, check_robot
from soft_tendon_env.robots.safety import RobotStopped, SafeRobot, Stop
from soft_tendon_env.tools.checks import checked_count, checked_number, checked_type
from soft_tendon_env.tools.configuration import ConfigurationError, Problem
from soft_tendon_env.tools.messages import first_line
from soft_tendon_env.tools.types import Array

SETTLE = 1.0  # [s] in which an arm is brought to where episodes begin
PATIENCE = 3  # control periods without a new reading, or behind the deadlines, after which an arm is let go
REST_SPEED = 0.005  # of the tip at rest, in lengths of the arm per second
REHEARSED = 5  # periods: controllers and estimators come to all that they compile within two or three
FINISHED = "the run ended"  # cause of the stop of a run that went on to its end


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


class Report(NamedTuple):
    """Report of a run: errors (m,) by name as measured in every period, timing, and how it ended."""

    errors: dict[str, Array]
    timing: Timing
    stop: Stop

    @property
    def finished(self) -> bool:
        """Whether it went on to its end."""
        return self.stop.cause == FINISHED


def rehearse(policy: Policy, env: gym.Env[Any, Any], seed: int = 0) -> None:
    """Plays a few periods with the simulated arm of an environment, so that nothing is compiled while a robot waits.

    Before the environment gets its robot. Raises as the policy.
    """
    for k, _ in enumerate(play_steps(policy, env, [seed])):
        if k == REHEARSED:
            return


def run_policy(policy: Policy, env: gym.Env[Any, Any], seconds: float, seed: int = 0) -> Report:
    """Runs a policy on a robot for so long [s]; lets the tendons go and closes the robot whatever happens.

    env: a RobotEnv, alone or wrapped. A robot that is stopped ends the run, `Report.stop` says why, as for an episode that ends early; what
    the policy raises, and KeyboardInterrupt, as which SIGTERM acts too, go on to the caller with slack tendons. Raises TypeError for other
    environments, ValueError for episodes that are shorter than the run.
    """
    robot, episodes = robot_of(env), episodes_of(env)
    steps, found = round(seconds / episodes.period), list[list[float]]()
    longest = None if env.spec is None else env.spec.max_episode_steps
    try:
        if longest is not None and longest < steps:
            text = f"{seconds:g} s are {steps} control periods, and episodes end after {longest}: gym.make(..., max_episode_steps={steps})"
            raise ValueError(f"seconds: {text}")
        for k, step in enumerate(play_steps(policy, env, [seed])):
            if robot.stopped is None:
                found.append([float(values[0]) for values in episodes.errors.values()])
            if k == steps or step.ended[0]:
                robot.stop(FINISHED if k == steps else f"the episode ended after {k} of {steps} control periods")
                break
    except RobotStopped as stopped:  # before it came to where episodes begin
        robot.stop(str(stopped))
    except BaseException as error:
        robot.stop("interrupted" if isinstance(error, KeyboardInterrupt) else first_line(error))
        raise
    finally:
        timing = robot.timing
        env.close()
    errors = np.array(found).reshape(-1, len(episodes.errors)).T
    return Report(dict(zip(episodes.errors, errors, strict=True)), timing, robot.stop(FINISHED))
