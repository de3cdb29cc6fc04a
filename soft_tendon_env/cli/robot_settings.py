"""Options of the commands that drive a robot, `run` and `collect`, and the robot that they open."""

import importlib
from collections.abc import Mapping
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import gymnasium as gym
from pydantic import Field

from soft_tendon_env.robots.environment import PATIENCE, REST_SPEED, SETTLE, RobotEnv
from soft_tendon_env.robots.process import RobotProcess
from soft_tendon_env.robots.protocol import Robot, check_robot
from soft_tendon_env.tools.configuration import Configuration, parsed_changes, shown
from soft_tendon_env.tools.extensions import look_in_this_folder
from soft_tendon_env.tools.types import NotNegative, Positive

SIMULATED = "soft_tendon_env.robots:SimulatedRobot"


class RobotSettings(Configuration):
    """The robot that a command drives, and its limits."""

    robot: str = Field(
        default=SIMULATED,
        description="class of the robot, MODULE:CLASS; by default a simulated arm in real time",
    )
    robot_options: tuple[str, ...] = Field(
        default=(), description="keyword arguments of that class, KEY=VALUE with values as in TOML"
    )
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

    def opened(
        self, env: gym.Env[Any, Any], log: str | Path, of_arm: Mapping[str, Any]
    ) -> RobotEnv:
        """Opens the robot as an environment, which closes it.

        Args:
            env: of the arm, whose actions go to the robot.
            log: a new .csv file.
            of_arm: options that a simulated robot has from the arm.

        Returns:
            The environment of the robot. Raises ValueError, and what the robot's class raises.
        """
        robot_options = dict[str, Any]()
        if self.robot == SIMULATED:
            robot_options |= of_arm
        robot_options |= parsed_changes(self.robot_options)
        robot = load_robot(self.robot, robot_options)
        with ExitStack() as on_error:
            on_error.callback(robot.close)
            real = RobotEnv(
                env,
                robot,
                log=log,
                rate=self.rate,
                settle=self.settle,
                rest_speed=self.rest_speed,
                patience=self.patience,
            )
            on_error.pop_all()
        return real


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
