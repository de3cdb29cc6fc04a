"""`soft-tendon run`: a policy on a robot, real or simulated, with a log of it."""

import importlib
from collections.abc import Mapping
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import gymnasium as gym
from pydantic import Field
from tyro.conf import Positional

from soft_tendon_env.cli.errors import mistakes, require
from soft_tendon_env.cli.options import EnvironmentArguments
from soft_tendon_env.envs import IDS
from soft_tendon_env.envs.episodes import episodes_of
from soft_tendon_env.envs.tracking import error_unit
from soft_tendon_env.evaluation.metrics import root_mean_square
from soft_tendon_env.evaluation.provenance import machine
from soft_tendon_env.evaluation.settings import EpisodeSettings, Seed, TaskName, episode_steps
from soft_tendon_env.policies.names import PolicyName
from soft_tendon_env.policies.protocol import Policy
from soft_tendon_env.recording import RecordRollout
from soft_tendon_env.robots.environment import (
    PATIENCE,
    REST_SPEED,
    SETTLE,
    RobotEnv,
    rehearse,
    run_policy,
)
from soft_tendon_env.robots.log import check_log
from soft_tendon_env.robots.process import RobotProcess
from soft_tendon_env.robots.protocol import Robot, check_robot
from soft_tendon_env.robots.simulated import OF_ARM
from soft_tendon_env.tools.configuration import parsed_changes, shown
from soft_tendon_env.tools.extensions import look_in_this_folder
from soft_tendon_env.tools.messages import UserError
from soft_tendon_env.tools.types import NotNegative, Positive

SIMULATED = "soft_tendon_env.robots:SimulatedRobot"
POLICY = (
    "a controller's name behind filtered:; an agent's folder; agent, ppo, sac, dagger,"
    " apg; module:name"
)


class Run(EnvironmentArguments, EpisodeSettings):
    """Run a policy on a robot in real time, print its errors as measured and the jitter of the
    loop, and write a log."""

    policy: Positional[str] = Field(description=POLICY)
    robot: str = Field(
        default=SIMULATED,
        description="class of the robot, MODULE:CLASS; by default a simulated arm in real time",
    )
    robot_options: tuple[str, ...] = Field(
        default=(), description="keyword arguments of that class, KEY=VALUE with values as in TOML"
    )
    task: TaskName = Field(
        default="TipPose",
        description="name of the task: TipPose, Reach, or one that was registered",
    )
    seed: Seed = Field(default=0, description="of the target")
    rate: Positive | None = Field(
        default=None,
        description="largest rate of a command [N/s], of displacements [m/s]; unlimited by default",
    )
    settle: NotNegative = Field(
        default=SETTLE,
        description="time [s] to bring the arm to the pretension; 0 where it is there",
    )
    rest_speed: Positive = Field(
        default=REST_SPEED,
        description="greatest speed of the tip at rest, in lengths of the arm per second",
    )
    patience: int = Field(
        default=PATIENCE,
        ge=1,
        description="periods without a reading, or late, after which the tendons go slack",
    )
    beyond_training: bool = Field(
        default=False, description="let an agent act on an arm that is none of its training"
    )
    record: str | None = Field(
        default=None,
        description="file for the Rerun viewer: the measured tip over the simulated arm",
    )
    out: str = Field(default="out/run.csv", description="log, a new .csv file")


def run(settings: Run) -> None:
    """Run, print and write. Raises UserError where the robot was stopped before the end."""
    out = Path(settings.out)
    task = settings.task
    with mistakes(), ExitStack() as on_error:
        check_log(out)
        if settings.record:
            require("recording")
        steps = episode_steps(settings.seconds, settings.skip, settings.options)
        name = PolicyName.parse(settings.policy, task)
        options = name.options(settings.options)
        env = gym.make(IDS[task], max_episode_steps=steps, **options)
        policy = load_trained(name, env, settings.beyond_training)
        rehearse(policy, env, settings.seed)

        robot_options = dict[str, Any]()
        if settings.robot == SIMULATED:  # it has the arm of the environment
            of_arm = {key: options[key] for key in OF_ARM if key in options}
            robot_options |= of_arm
        robot_options |= parsed_changes(settings.robot_options)
        robot = load_robot(settings.robot, robot_options)
        on_error.callback(robot.close)
        real: gym.Env[Any, Any] = RobotEnv(
            env,
            robot,
            log=settings.out,
            rate=settings.rate,
            settle=settings.settle,
            rest_speed=settings.rest_speed,
            patience=settings.patience,
        )
        # From here the environment closes the robot.
        on_error.pop_all()
        on_error.callback(real.close)
        if settings.record:
            # Writing meanwhile would take longer than a period.
            real = RecordRollout(real, settings.record, flush_period=None)
        on_error.pop_all()
    print(f"{settings.policy} on {settings.robot}, {settings.seconds:g} s; {machine()}\n")
    try:
        report = run_policy(policy, real, settings.seconds, settings.seed)
    finally:  # also after Ctrl-C
        if out.exists():
            print(f"written: {out}")
        stop = real.get_wrapper_attr("stopped")
        if stop:
            tendons = "slack"
            if not stop.slack:
                tendons = f"not slack, the robot does not answer: {stop.failures[-1]}"
            milliseconds = 1e3 * stop.seconds
            print(f"{stop.cause}: tendons {tendons} after {milliseconds:.0f} ms\n")

    periods = settings.skip / episodes_of(real).period
    skipped_periods = round(periods)
    for error, values in report.errors.items():
        counted = values[skipped_periods:]
        if counted.size:
            unit = error_unit(error)
            text = unit.text(root_mean_square(counted))
            print(f"{unit.label}: {text} (root mean square, as measured)")
    print(report.timing)
    if not report.finished:
        raise UserError(f"the robot was stopped: {report.stop.cause}")


def load_trained(name: PolicyName, env: Any, beyond_training: bool) -> Policy:
    """The policy of a name, for an arm of its training unless it may act on any.

    Raises ValueError, OSError.
    """
    if beyond_training:
        return name.load_beyond_training(env)
    outside = name.outside(env)
    if outside:
        raise ValueError(
            f"{name.text} was not trained for this arm: {outside}. Train an agent for it, or let"
            " this one act all the same with --beyond-training"
        )
    return name.load(env)


def load_robot(name: str, options: Mapping[str, Any]) -> Robot:
    """The robot that a class MODULE:CLASS, also of the current folder, makes of these options.

    One with own_process, see Robot, is made in a process of its own.

    Raises ValueError, and what that raises.
    """
    look_in_this_folder()
    module, _, attribute = name.partition(":")
    try:
        make = getattr(importlib.import_module(module), attribute)
        if getattr(make, "own_process", False):
            return RobotProcess(make, **options)
        robot: Robot = make(**options)
        check_robot(robot)
    except (ImportError, AttributeError, TypeError) as error:
        raise ValueError(
            f"robot is {name!r} with the options {shown(dict(options))}: it should be MODULE:CLASS;"
            f" {error}"
        ) from error
    return robot
