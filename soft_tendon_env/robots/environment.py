"""Robot behind the Gymnasium interface of a simulated arm, and runs of policies on it.

Policies and Stable-Baselines3 stay as they are.

`env =
RobotEnv(gym.make("TendonRod-Reach-v0", scene="my_arm.toml", observation="measurable", sensors=3),
MyRobot())`
"""

import itertools
from collections import deque
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

import gymnasium as gym
import numpy as np
import scipy.fft

from soft_tendon_env.envs.arms import Arms, Indices
from soft_tendon_env.envs.environments import TendonRodEnv
from soft_tendon_env.envs.episodes import Episodes, episodes_of
from soft_tendon_env.evaluation.play import play_steps
from soft_tendon_env.mechanics.motion.scratch import Tape
from soft_tendon_env.mechanics.motion.status import OK
from soft_tendon_env.policies.protocol import Policy
from soft_tendon_env.robots.clock import Pacer, Timing
from soft_tendon_env.robots.log import RobotLog
from soft_tendon_env.robots.misfit import misfit
from soft_tendon_env.robots.protocol import Measurement, Robot, check_robot, read_fields
from soft_tendon_env.robots.safety import FINISHED, ArmBounds, RobotStopped, SafeRobot
from soft_tendon_env.robots.slack import Stop
from soft_tendon_env.robots.top_speed import half_swing, top_speed
from soft_tendon_env.tools.checks import checked_count, checked_number, checked_type
from soft_tendon_env.tools.configuration import ConfigurationError, Problem
from soft_tendon_env.tools.messages import describe, first_line
from soft_tendon_env.tools.types import Array

POSITIVE = 1e-9  # least number that counts as one
SETTLE = 1.0  # [s] in which an arm is brought to where episodes begin
# control periods without a new reading, or behind the deadlines, after which an arm is let go
PATIENCE = 3
REST_SPEED = 0.005  # of the tip at rest, in lengths of the arm per second
READINGS = 20  # of which a speed is measured at least
LOOKS = 10  # in the window of a speed; an arm rests when it did twice on end
# [s] over which a speed is measured at least, which shows 1.5 mm/s in noise of 2 mm
WINDOW = 2.0
WAIT = 60.0  # [s] which rest may take
REHEARSED = 6  # periods: controllers and estimators compile within two or three
# power of a mode over the median of all that is motion: one of 10,000 modes of white noise has as
# much
STANDS_OUT = 33.0


class RobotEnv(gym.Wrapper[Any, Any, Any, Any]):
    """Robot in place of the simulated arm of an environment with one arm.

    `reset` brings the robot from slack tendons to the first command, the pretension, and waits
    until it is at rest. The measurement at rest is the zero of tendon lengths and strains. Commands
    stay within the environment's limits. If the robot is stopped, see safety.py, the episode is
    truncated, and `info["stopped"]` says why; `reset` begins again. `close` makes the tendons slack
    and closes the robot.

    Args:
        env: of gym.make, with one arm.
        robot: in place of that arm.
        rate: largest rate of commands [N/s, or m/s]; None: unlimited.
        settle: time [s] to the first command; 0 for a robot that rests there when the first episode
            begins, with sensors that have zeros.
        rest_speed: greatest speed of the tip at rest, root mean square, in lengths of the arm per
            second.
        patience: periods without a new reading, or behind the deadlines, after which the robot is
            stopped.
        log: new CSV file of the periods, see log.py.

    Raises:
        ConfigurationError: where the robot does not fit the environment.
        TypeError: for other arguments of wrong type.
        ValueError: for other arguments of wrong range.
        OSError: where the log cannot be written.
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
        reason = misfit(robot, episodes)
        if reason:
            message = f"is {type(robot).__name__}, {reason}"
            problem = Problem(("robot",), message)
            raise ConfigurationError([problem], "environment")
        fastest = np.inf
        if rate is not None:
            fastest = checked_number("rate", rate, POSITIVE, "a positive number, or None")
        settle = checked_number("settle", settle, 0.0, "a number of seconds, at least 0")
        rest_speed = checked_number(
            "rest_speed", rest_speed, POSITIVE, "a positive number of lengths per second"
        )
        model = episodes.model
        actions = episodes.actuation.actions
        columns = [actions.least, actions.greatest]
        limits = np.stack(columns, axis=1)
        sensors = episodes.sensors.size
        patience = checked_count("patience", patience, 1)
        bounds = _bounds(episodes)
        self._log: RobotLog | None = None
        if log is not None:
            self._log = RobotLog(
                Path(log),
                robot.command_unit,
                read_fields(robot, sensors),
                tendons=len(limits),
                sensors=sensors,
            )
        # last of what can fail: from here on it holds signals, until `close`
        self._safe = SafeRobot(
            robot,
            limits,
            sensors,
            bounds,
            period=episodes.period,
            rate=fastest,
            patience=patience,
        )
        arm = MeasuredArm(
            episodes,
            self._safe,
            settle=settle,
            still=rest_speed * model.length,
            log=self._log,
        )
        self._last: Any = None
        # found by the last reset, added to what the robot measures: tendon_length (n_a,) [m],
        # strain (s, 6)
        self.zero = arm.zero
        episodes.attach(arm)

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Any, dict[str, Any]]:
        """Begins a new episode, with the robot at rest.

        Args:
            seed: as of the environment.
            options: as of the environment.

        Returns:
            The observation and the info.

        Raises:
            RobotStopped: if the robot does not come to rest.
        """
        self._last = self.env.reset(seed=seed, options=options)
        return self._last

    def step(self, action: Any) -> tuple[Any, float, bool, bool, dict[str, Any]]:
        """Takes one control period, to its deadline.

        A robot that is stopped truncates the episode, with the last observation and reward 0.

        Args:
            action: (n_a,) in [-1, 1]; larger ones are clipped.

        Returns:
            Observation, reward, whether the episode is terminated, whether it is truncated, info.

        Raises:
            TypeError: for an action of wrong type.
            ValueError: for an action of wrong shape or with NaN.
            gymnasium.error.ResetNeeded: before the first reset.
        """
        if self._last is None:
            raise gym.error.ResetNeeded("step was called before reset")
        try:
            observation, reward, terminated, truncated, info = self.env.step(action)
        except RobotStopped as stopped:
            observation, info = self._last
            last_info = {**info, "stopped": str(stopped)}
            return observation, 0.0, False, True, last_info
        self._last = observation, info
        return observation, float(reward), terminated, truncated, info

    @property
    def stopped(self) -> Stop | None:
        """Course of the last stop; None while the robot runs."""
        return self._safe.stopped

    def stop(self, cause: str) -> Stop:
        """Lets the tendons go, from any thread, and waits until they are slack.

        Args:
            cause: of the stop, in words.

        Returns:
            The course of the stop; the first cause counts.
        """
        return self._safe.stop(cause)

    def close(self) -> None:
        """Lets the tendons go, closes the robot, and completes the log."""
        try:
            self._safe.close()
        finally:  # also where Ctrl-C comes meanwhile
            if self._log is not None:
                self._log.close()
            super().close()


def _bounds(episodes: Episodes) -> ArmBounds:
    """Bounds of what can be measured of the arm of episodes."""
    base = episodes.model.scene.base.position
    if episodes.model.scene.effects.moving_base:
        # no tip is too far from where the base was, nor too fast
        return ArmBounds(base, length=np.inf, top_speed=np.inf)
    return ArmBounds(base, episodes.model.length, top_speed(episodes))


class MeasuredArm(Arms):
    """The robot as one row of arms, whose steps command it and whose reading is what it measures.

    still: greatest speed [m/s] at rest. The simulated arm goes on beside it under the commands that
    were sent: it is what recordings show, and nothing of it is observed.
    """

    def __init__(
        self,
        episodes: Episodes,
        robot: SafeRobot,
        settle: float,
        still: float,
        log: RobotLog | None,
    ) -> None:
        super().__init__(
            episodes.model,
            rows=1,
            period=episodes.period,
            stations=np.empty(0),
            sensors=episodes.sensors,
        )
        self.robot = robot
        self.pacer = Pacer(robot.clock, episodes.period)
        self._still = still
        self._log = log
        self._command = episodes.start_command
        self._actuation = episodes.actuation
        # the pretension is not there before the rate has led to it
        differences = self._command - robot.slack
        distances = np.abs(differences)
        way = float(distances.max())
        seconds = way / robot.rate
        self._rise = max(settle, seconds)
        # [s], at least half a swing, which stands still where it turns
        self._window = max(WINDOW, half_swing(episodes))
        self._is_there = settle == 0.0  # whether the robot rests under the first command
        self._has_zeros = settle == 0.0
        self.zero = dict[str, Array]()  # by field, added to what the robot measures

    def place(self, members: Indices, q: Array, tension: Array | None = None) -> None:
        """Let the robot begin, from slack tendons.

        Raises RobotStopped, also where it does not come to rest.
        """
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
            names = {"tendon_length", "strain"} & {*self.robot.senses}
            for name in names:
                # the simulated arm is at rest under the same command
                values_by_reading = [getattr(reading, name) for reading in readings]
                measured = np.mean(values_by_reading, axis=0)
                value = getattr(self.reading, name)[0]
                self.zero[name] = value - measured
        # of the last two the earlier one is the log's row before time 0; there may be one alone
        last = readings[-2:][0]
        self._take(last)
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
        """Sends the command of a period (1, parts, n_a), and measures at its end.

        The command becomes what was sent. Raises RobotStopped.
        """
        asked = command[0, -1].copy()
        sent = self.robot.write(asked)
        if self._log is not None:
            time = self.pacer.period * self.pacer.count
            try:
                self._log.append(time, self._time, self.reading, asked, sent)
            except OSError as error:
                message = f"the log {self._log.path} cannot be written: {describe(error)}"
                self.robot.fail(message)
        command[:] = sent
        self._actuation.command[0] = sent
        super().step(command, members, durations, tape)  # one that begins, whatever was asked
        self.outcome.status[:] = OK  # a robot does not diverge
        measured = self.robot.read(self.pacer.wait())
        self._take(measured)

    def _take(self, measured: Measurement) -> None:
        """Make a measurement the reading, with the zeros of the arm at rest."""
        self._time = measured.time
        self.reading.tension[:] = np.nan  # unless it is measured
        for name in self.robot.senses:
            zero = self.zero.get(name, 0.0)
            value = getattr(measured, name)
            getattr(self.reading, name)[0] = value + zero

    def _wait_for_rest(self) -> list[Measurement]:
        """Last readings of the arm at rest under the first command.

        The command rises evenly from slack. Raises RobotStopped.
        """
        period = self.pacer.period
        slack = self.robot.slack
        # in periods
        periods_of_rise = round(self._rise / period)
        rise = max(periods_of_rise, 1)
        periods = round(self._window / period)
        window = max(periods, READINGS)
        between_looks = max(window // LOOKS, 1)
        last = deque[tuple[int, Measurement]](maxlen=window)  # new readings, by their period
        was_still = False
        for k in itertools.count(1 - rise):  # period 0 is the first at the whole command
            part = (k + rise) / rise
            share = min(part, 1.0)
            way = self._command - slack
            command = slack + share * way
            self.robot.write(command)
            self.pacer.wait()
            measured = self.robot.read()
            is_new = not last or measured.time_of_pose != last[-1][1].time_of_pose
            if k > 0 and is_new:
                last.append((k, measured))
            is_short = len(last) < window
            if is_short or k % between_looks:
                continue
            speed = self._speed(last)
            is_still = speed <= self._still
            if is_still and was_still:
                break
            was_still = is_still
            is_late = period * k >= WAIT
            if is_late and not is_still:
                self.robot.fail(
                    f"the arm does not come to rest: its tip moves at {speed:.3g} m/s,"
                    f" {period * k:g} s after the first command; at rest it is at most"
                    f" {self._still:.3g} m/s. Allow more, by rest_speed, or damp the arm"
                )
        return [reading for _, reading in last]

    def _speed(self, readings: Sequence[tuple[int, Measurement]]) -> float:
        """Speed [m/s] of the tip in readings by their period, taken as evenly apart."""
        first, _ = readings[0]
        last, _ = readings[-1]
        poses = [reading.tip_pose for _, reading in readings if reading.tip_pose is not None]
        tips = [pose[:3, 3] for pose in poses]
        positions = np.array(tips)
        steps = len(readings) - 1
        elapsed = self.pacer.period * (last - first)
        between = elapsed / steps  # [s]
        return speed_of(positions, between)


def speed_of(position: Array, period: float) -> float:
    """Returns the speed of a point, root mean square, from noisy positions.

    It is of the cosine modes that stand out of noise. Differences of samples are mostly noise: 1 mm
    at 50 Hz makes 70 mm/s.

    Args:
        position: (m, 3) [m].
        period: from one to the next [s].

    Returns:
        The speed [m/s].
    """
    count = len(position)
    spectrum = scipy.fft.dct(position, axis=0, norm="ortho")
    amplitude = spectrum[1:]  # without the mean
    power = amplitude**2 / count
    typical = np.median(power, axis=0)
    is_motion = power > STANDS_OUT * typical
    motion = np.sum(power, axis=1, where=is_motion)
    order = np.arange(1, count)
    angle = np.pi * order
    rate = angle / (count * period)  # [rad/s] of the modes
    products = rate**2 * motion
    square = np.sum(products)
    return float(np.sqrt(square))


class Report(NamedTuple):
    """Report of a run: errors, timing, how it ended, and whether it went on to its end.

    Errors (m,) are by name, as measured in every period.
    """

    errors: dict[str, Array]  # (periods,) each, by name, in SI units
    timing: Timing  # how punctual the loop was
    stop: Stop  # how the tendons were let go
    finished: bool = False  # whether all periods were run


def rehearse(policy: Policy, env: gym.Env[Any, Any], seed: int = 0) -> None:
    """Runs a policy for a few periods on the simulated arm of an environment.

    After that nothing is compiled while the robot waits.

    Args:
        policy: to run.
        env: of the simulated arm.
        seed: of the episode.
    """
    steps = play_steps(policy, env, [seed])
    for _ in itertools.islice(steps, REHEARSED):
        pass


def run_policy(policy: Policy, env: gym.Env[Any, Any], seconds: float, seed: int = 0) -> Report:
    """Runs a policy on a robot for a duration, then slackens the tendons and closes the robot.

    A stopped robot ends the run, as does an episode that ends early: `Report.stop` says why. What
    the policy raises, and KeyboardInterrupt, as which SIGTERM acts too, go on to the caller with
    slack tendons.

    Args:
        policy: to run.
        env: a RobotEnv, alone or wrapped.
        seconds: duration [s].
        seed: of the episode.

    Returns:
        Errors of every period, timing, and how the run ended.

    Raises:
        TypeError: for other environments.
        ValueError: for episodes that are shorter than the run.
    """
    episodes = episodes_of(env)
    arm = episodes.arms
    if not isinstance(arm, MeasuredArm):
        raise TypeError("env should be a RobotEnv, alone or wrapped")
    robot = arm.robot
    steps = round(seconds / episodes.period)
    errors = list[list[float]]()  # of every period, by the names of the episodes' errors
    try:
        _check_length(env, seconds, steps)
        played = play_steps(policy, env, [seed])
        for k, step in enumerate(played):
            if robot.stopped is None:
                values_of_rows = episodes.errors.values()
                last_errors = [float(values[0]) for values in values_of_rows]
                errors.append(last_errors)
            if k == steps:
                robot.stop(FINISHED)
                break
            if step.ended[0]:
                robot.stop(f"the episode ended after {k} of {steps} control periods")
                break
    except BaseException as error:
        is_interrupt = isinstance(error, KeyboardInterrupt)
        robot.stop("interrupted" if is_interrupt else first_line(error))
        if not isinstance(error, RobotStopped):  # before it came to where episodes begin
            raise
    finally:
        timing = arm.pacer.timing
        env.close()
    by_episode = np.array(errors)
    error_count = len(episodes.errors)
    by_name = by_episode.reshape(-1, error_count).T
    stop = robot.stop(FINISHED)
    return Report(
        errors=dict(zip(episodes.errors, by_name, strict=True)),
        timing=timing,
        stop=stop,
        finished=stop.cause == FINISHED,
    )


def _check_length(env: gym.Env[Any, Any], seconds: float, steps: int) -> None:
    """Raises ValueError where episodes end before a run of so many control periods."""
    if env.spec is None:
        return
    longest = env.spec.max_episode_steps or steps
    if longest < steps:
        raise ValueError(
            f"seconds: {seconds:g} s are {steps} control periods, and episodes end after {longest}:"
            f" gym.make(..., max_episode_steps={steps})"
        )
