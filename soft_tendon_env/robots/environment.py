"""Robot behind the Gymnasium interface of a simulated arm, for policies and Stable-Baselines3 as
they are, and runs of policies on it.

`env =
RobotEnv(gym.make("TendonRod-Reach-v0", scene="my_arm.toml", observation="measurable", sensors=3),
MyRobot())`
"""

import itertools
from collections import deque
from pathlib import Path
from typing import Any, NamedTuple

import gymnasium as gym
import numpy as np
import scipy.fft

from soft_tendon_env.envs.arms import Arms, Indices
from soft_tendon_env.envs.environments import TendonRodEnv
from soft_tendon_env.envs.episodes import Episodes, episodes_of
from soft_tendon_env.envs.observation import HISTORY
from soft_tendon_env.envs.tasks import TIP
from soft_tendon_env.evaluation.play import play_steps
from soft_tendon_env.mechanics.motion.scratch import Tape
from soft_tendon_env.mechanics.motion.status import OK
from soft_tendon_env.model.step_control import RESOLVED, linear_rate
from soft_tendon_env.policies.estimators import PARAMETERS
from soft_tendon_env.policies.protocol import Policy
from soft_tendon_env.policies.regimes import TARGET_GROUPS
from soft_tendon_env.robots.log import RobotLog
from soft_tendon_env.robots.protocol import Measurement, Robot, check_robot
from soft_tendon_env.robots.safety import FINISHED, Pacer, RobotStopped, SafeRobot, Stop, Timing
from soft_tendon_env.tools.checks import checked_count, checked_number, checked_type
from soft_tendon_env.tools.configuration import ConfigurationError, Problem
from soft_tendon_env.tools.messages import describe, first_line
from soft_tendon_env.tools.types import Array

SETTLE = 1.0  # [s] in which an arm is brought to where episodes begin
# control periods without a new reading, or behind the deadlines, after which an arm is let go
PATIENCE = 3
REST_SPEED = 0.005  # of the tip at rest, in lengths of the arm per second
READINGS, LOOKS = (
    20,
    10,
    # of which a speed is measured at least, and looks in its window; an arm rests when it did twice
    # on end
)
WINDOW, WAIT = (
    2.0,
    60.0,
    # [s] over which a speed is measured at least, which shows 1.5 mm/s in noise of 2 mm, and for
    # which rest may take
)
# power of a mode over the median of all that is motion: one of 10,000 modes of white noise has as
# much
STANDS_OUT = 33.0


class RobotEnv(gym.Wrapper[Any, Any, Any, Any]):
    """A robot in place of the simulated arm of an environment with one arm, made by `gym.make`.

    `reset` brings the robot from slack tendons to the first command, the pretension, and waits
    until it is at rest. The measurement at rest is the zero of tendon lengths and strains. Commands
    stay within the environment's limits. If the robot is stopped, see safety.py, the episode is
    truncated, and `info["stopped"]` says why; `reset` begins again. `close` makes the tendons slack
    and closes the robot.

    rate: largest rate of commands [N/s, or m/s]; None: unlimited. settle: time [s] to the first
    command; 0 for a robot that rests there when the first episode begins, with sensors that have
    zeros. rest_speed: greatest speed of the tip at rest, root mean square, in lengths of the arm
    per second. patience: periods without a new reading, or behind the deadlines, after which the
    robot is stopped. log: new CSV file of the periods, see log.py. Raises ConfigurationError where
    the robot does not fit the environment, TypeError, ValueError, OSError.
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
        check_robot(robot)
        episodes = checked_type(
            "env", env.unwrapped, TendonRodEnv, "made by gym.make('TendonRod-TipPose-v0')"
        ).episodes
        if reason := _misfit(robot, episodes):
            raise ConfigurationError(
                [Problem(("robot",), f"is {type(robot).__name__}, {reason}")], "environment"
            )
        fastest = (
            np.inf
            if rate is None
            else checked_number("rate", rate, 1e-9, "a positive number, or None")
        )
        settle = checked_number("settle", settle, 0.0, "a number of seconds, at least 0")
        still = (
            checked_number(
                "rest_speed", rest_speed, 1e-9, "a positive number of lengths per second"
            )
            * episodes.model.length
        )
        limits = np.stack(
            [episodes.actuation.actions.least, episodes.actuation.actions.greatest], axis=1
        )
        scene, sensors = episodes.model.scene, episodes.sensors.size
        place = scene.base.position, np.inf if scene.effects.moving_base else episodes.model.length
        self._safe = SafeRobot(
            robot,
            limits,
            sensors,
            place,
            episodes.period,
            fastest,
            checked_count("patience", patience, 1),
        )
        self._log = (
            None
            if log is None
            else RobotLog(Path(log), robot.command_unit, self._safe.senses, len(limits), sensors)
        )
        arm = MeasuredArm(episodes, self._safe, settle, still, self._log)
        self._last: Any = None
        # found by the last reset, added to what the robot measures: tendon_length (n_a,) [m],
        # strain (s, 6)
        self.zero = arm.zero
        episodes.attach(arm)

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Any, dict[str, Any]]:
        """A new episode, which begins with the robot at rest. Raises RobotStopped if it does not
        come to rest."""
        self._last = self.env.reset(seed=seed, options=options)
        return self._last

    def step(self, action: Any) -> tuple[Any, float, bool, bool, dict[str, Any]]:
        """One control period, to its deadline; a robot that is stopped truncates the episode, with
        the last observation and reward 0. Raises as the environment for actions of wrong shape or
        with NaN, ResetNeeded."""
        if self._last is None:
            raise gym.error.ResetNeeded("step was called before reset")
        try:
            observation, reward, terminated, truncated, info = self.env.step(action)
        except RobotStopped as stopped:
            observation, info = self._last
            return observation, 0.0, False, True, {**info, "stopped": str(stopped)}
        self._last = observation, info
        return observation, float(reward), terminated, truncated, info

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
        finally:  # also where Ctrl-C comes meanwhile
            if self._log is not None:
                self._log.close()
            super().close()


def _misfit(robot: Robot, episodes: Episodes) -> str:
    """Reason why a robot cannot play an environment's episodes; "": it can."""
    options, groups, fields = (
        episodes.options,
        episodes.layout.slices,
        {**dict.fromkeys(TIP, "tip_pose"), **PARAMETERS},
    )
    if robot.command_unit != (unit := episodes.model.command_unit):
        return (
            f"which takes {robot.command_unit!r}, and the scene's arm takes {unit!r}: see"
            " [effects.tendon_elasticity]"
        )
    if (
        options.randomize.numbers
        or options.randomize.of_actuators
        or options.randomize.latency != (0.0, 0.0)
    ):
        return (
            "as it is: the option randomize should have no more than the noise of its sensors, for"
            " policies that know of it"
        )
    needed = {
        **{fields[name]: name for name in groups if name in fields},
        "tip_pose": "the errors of the task",
    }
    needed |= (
        {"tip_twist": "the option tip_speed_limit"} if options.tip_speed_limit is not None else {}
    )
    if missing := [f"{name} ({why})" for name, why in needed.items() if name not in robot.senses]:
        return (
            f"without {', '.join(missing)}, which is observed: take it out of the option"
            " observation; controllers: filtered:NAME"
        )
    if episodes.task.shapes or (
        odd := [name for name in groups if name not in {*fields, *TARGET_GROUPS, HISTORY}]
    ):
        return (
            "measured at its tip and by its sensors"
            f" alone{'' if episodes.task.shapes else ': not ' + ', '.join(odd)}"
        )
    return ""


class MeasuredArm(Arms):
    """The robot as one row of arms, whose steps command it and whose reading is what it measures.
    still: greatest speed [m/s] at rest. The simulated arm goes on beside it under the commands that
    were sent: it is what recordings show, and nothing of it is observed."""

    def __init__(
        self,
        episodes: Episodes,
        robot: SafeRobot,
        settle: float,
        still: float,
        log: RobotLog | None,
    ) -> None:
        super().__init__(episodes.model, 1, episodes.period, np.empty(0), episodes.sensors)
        self.robot, self.pacer, self._still, self._log = (
            robot,
            Pacer(robot.clock, episodes.period),
            still,
            log,
        )
        self._command, self._actuation = episodes.start_command, episodes.actuation
        # the pretension is not there before the rate has led to it
        self._rise = max(settle, float(np.abs(self._command - robot.slack).max()) / robot.rate)
        self._window = max(
            WINDOW, np.pi / (RESOLVED * linear_rate(episodes.model))
        )  # [s], half a swing, which stands still where it turns
        self._is_there = self._has_zeros = settle == 0.0
        self.zero = dict[str, Array]()  # by field, added to what the robot measures

    def place(self, members: Indices, q: Array, tension: Array | None = None) -> None:
        """Let the robot begin, from slack tendons. Raises RobotStopped, also where it does not come
        to rest."""
        super().place(members, q, tension)
        self.robot.begin()
        self.pacer = Pacer(self.robot.clock, self.pacer.period)
        if self._is_there:
            self.robot.write(self._command)
            readings = [self.robot.read()]
        else:
            readings = self._wait_for_rest()
            self.pacer = Pacer(self.robot.clock, self.pacer.period)
        self._is_there = False
        if not self._has_zeros:
            for name in {"tendon_length", "strain"} & {*self.robot.senses}:
                self.zero[name] = getattr(self.reading, name)[0] - np.mean(
                    [getattr(one, name) for one in readings], axis=0
                )
        self._take(readings[-2:][0])
        if self._log is not None:
            self._log.begin(self.pacer.period, self._time, self.reading, self._command)
        self._take(readings[-1])

    def step(
        self,
        command: Array,
        members: Indices,
        durations: Array | None = None,
        tape: Tape | None = None,
        begins: bool = True,
    ) -> None:
        """Send the command of a period (1, parts, n_a), which becomes what was sent, and measure at
        its end. Raises RobotStopped."""
        asked = command[0, -1].copy()
        sent = self.robot.write(asked)
        if self._log is not None:
            try:
                self._log.append(
                    self.pacer.period * self.pacer.count, self._time, self.reading, asked, sent
                )
            except OSError as error:
                self.robot.fail(f"the log {self._log.path} cannot be written: {describe(error)}")
        command[:], self._actuation.command[0] = sent, sent
        super().step(command, members, durations, tape)  # one that begins, whatever was asked
        self.outcome.status[:] = OK  # a robot does not diverge
        self._take(self.robot.read(self.pacer.wait()))

    def _take(self, measured: Measurement) -> None:
        """Make a measurement the reading, with the zeros of the arm at rest."""
        self._time = measured.time
        self.reading.tension[:] = np.nan  # unless it is measured
        for name in self.robot.senses:
            getattr(self.reading, name)[0] = getattr(measured, name) + self.zero.get(name, 0.0)

    def _wait_for_rest(self) -> list[Measurement]:
        """The last readings of the arm at rest under the first command, which rises evenly from
        slack. Raises RobotStopped."""
        period, slack = self.pacer.period, self.robot.slack
        rise, window = (
            max(round(self._rise / period), 1),
            max(round(self._window / period), READINGS),
        )
        last, was_still = (
            deque[tuple[int, Measurement]](maxlen=window),
            False,
        )  # new readings, by their period
        for k in itertools.count(1 - rise):
            self.robot.write(slack + min((k + rise) / rise, 1.0) * (self._command - slack))
            self.pacer.wait()
            measured = self.robot.read()
            if k > 0 and (not last or measured.time != last[-1][1].time):
                last.append((k, measured))
            if len(last) < window or k % max(window // LOOKS, 1):
                continue
            positions = np.array(
                [one.tip_pose[:3, 3] for _, one in last if one.tip_pose is not None]
            )
            speed = speed_of(positions, period * (last[-1][0] - last[0][0]) / (window - 1))
            if speed <= self._still and was_still:
                break
            was_still = speed <= self._still
            if period * k >= WAIT and not was_still:
                text = (
                    f"the arm does not come to rest: its tip moves at {speed:.3g} m/s,"
                    f" {period * k:g} s after the first command"
                )
                self.robot.fail(
                    f"{text}; at rest it is at most {self._still:.3g} m/s. Allow more, by"
                    " rest_speed, or damp the arm"
                )
        return [one for _, one in last]


def speed_of(position: Array, period: float) -> float:
    """Speed [m/s], root mean square, of a point at positions (m, 3) [m] one period [s] apart: of
    the cosine modes that stand out of noise. Differences of samples are mostly noise: 1 mm at 50 Hz
    makes 70 mm/s."""
    power = scipy.fft.dct(position, axis=0, norm="ortho")[1:] ** 2 / len(position)
    power = np.sum(power, axis=1, where=power > STANDS_OUT * np.median(power, axis=0))
    rate = np.pi * np.arange(1, len(position)) / (len(position) * period)
    return float(np.sqrt(np.sum(rate**2 * power)))


class Report(NamedTuple):
    """Report of a run: errors (m,) by name as measured in every period, timing, how it ended, and
    whether it went on to its end."""

    errors: dict[str, Array]
    timing: Timing
    stop: Stop
    finished: bool = False


def rehearse(policy: Policy, env: gym.Env[Any, Any], seed: int = 0) -> None:
    """Runs a policy for a few periods on the simulated arm of an environment, so that nothing is
    compiled while the robot waits."""
    for _ in itertools.islice(
        play_steps(policy, env, [seed]), 6
    ):  # controllers and estimators compile within two or three periods
        pass


def run_policy(policy: Policy, env: gym.Env[Any, Any], seconds: float, seed: int = 0) -> Report:
    """Runs a policy on a robot for a duration [s]; in any case it slackens the tendons and closes
    the robot.

    env: a RobotEnv, alone or wrapped. A stopped robot ends the run, as does an episode that ends
    early: `Report.stop` says why. What the policy raises, and KeyboardInterrupt, as which SIGTERM
    acts too, go on to the caller with slack tendons. Raises TypeError for other environments,
    ValueError for episodes that are shorter than the run.
    """
    episodes, found = episodes_of(env), list[list[float]]()
    if not isinstance(arm := episodes.arms, MeasuredArm):
        raise TypeError("env should be a RobotEnv, alone or wrapped")
    robot, steps = arm.robot, round(seconds / episodes.period)
    try:
        if env.spec is not None and (longest := env.spec.max_episode_steps or steps) < steps:
            text = (
                f"{seconds:g} s are {steps} control periods, and episodes end after {longest}:"
                f" gym.make(..., max_episode_steps={steps})"
            )
            raise ValueError(f"seconds: {text}")
        for k, step in enumerate(play_steps(policy, env, [seed])):
            if robot.stopped is None:
                found.append([float(values[0]) for values in episodes.errors.values()])
            if k == steps or step.ended[0]:
                robot.stop(
                    FINISHED
                    if k == steps
                    else f"the episode ended after {k} of {steps} control periods"
                )
                break
    except BaseException as error:
        robot.stop("interrupted" if isinstance(error, KeyboardInterrupt) else first_line(error))
        if not isinstance(error, RobotStopped):  # before it came to where episodes begin
            raise
    finally:
        timing = arm.pacer.timing
        env.close()
    errors, stop = np.array(found).reshape(-1, len(episodes.errors)).T, robot.stop(FINISHED)
    return Report(
        dict(zip(episodes.errors, errors, strict=True)), timing, stop, stop.cause == FINISHED
    )
