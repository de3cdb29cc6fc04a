"""Runs of policies on robots: rehearsal in simulation, control loop in real time, and report."""

from typing import Any, NamedTuple

import gymnasium as gym
import numpy as np

from soft_tendon_env.envs.episodes import episodes_of
from soft_tendon_env.evaluation.play import play_steps
from soft_tendon_env.policies.protocol import Policy
from soft_tendon_env.robots.clock import Timing
from soft_tendon_env.robots.environment import robot_of
from soft_tendon_env.robots.safety import RobotStopped, Stop
from soft_tendon_env.tools.messages import first_line
from soft_tendon_env.tools.types import Array

REHEARSED = 5
"""Periods of a rehearsal: controllers and estimators come to all that they compile within two or three."""
FINISHED = "the run ended"
"""Cause of the stop of a run that went on to its end."""


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
