"""Real arm in place of a simulated one: an environment's `Arms` whose steps command a robot and whose reading is what it measures.

The simulated arm goes on beside it under the commands that were sent: it is what recordings show, and nothing of it is observed.
"""

import itertools
from collections import deque
from collections.abc import Mapping

import numpy as np
import scipy.fft

from soft_tendon_env.envs.arms import Arms, Indices
from soft_tendon_env.envs.episodes import Episodes
from soft_tendon_env.envs.observation import HISTORY
from soft_tendon_env.envs.tasks import TIP
from soft_tendon_env.mechanics.motion.scratch import Tape
from soft_tendon_env.mechanics.motion.status import OK
from soft_tendon_env.model.step_control import RESOLVED, linear_rate
from soft_tendon_env.policies.estimators import PARAMETERS
from soft_tendon_env.policies.regimes import TARGET_GROUPS
from soft_tendon_env.robots.clock import Pacer
from soft_tendon_env.robots.log import RobotLog
from soft_tendon_env.robots.protocol import Measurement, Robot
from soft_tendon_env.robots.safety import SafeRobot
from soft_tendon_env.tools.messages import describe
from soft_tendon_env.tools.types import Array

FIELDS: Mapping[str, str] = {**dict.fromkeys(TIP, "tip_pose"), **PARAMETERS}
"""Fields of a Measurement by the observation groups that are made of them."""
READINGS, LOOKS = 20, 10  # of which a speed is measured at least, and looks in its window; an arm rests when it did twice on end
WINDOW = 2.0  # [s] at least over which the speed is measured: at 50 Hz and with noise of 2 mm, it shows a drift of 1.5 mm/s
WAIT = 60.0  # [s] under the first command, for which rest is waited for
STANDS_OUT = 33.0  # power of a mode over the median of all that is motion: one of 10,000 modes of white noise has as much


class MeasuredArm(Arms):
    """One row, the robot. `place` brings it to rest where episodes begin, and makes that the zero of lengths and strains.

    is_there: the first episode finds it at rest under the first command, and its sensors have their zeros. rise: time [s] in which the
    command rises from slack. still: greatest speed [m/s] of the tip at rest.
    """

    def __init__(self, episodes: Episodes, robot: SafeRobot, is_there: bool, rise: float, still: float, log: RobotLog | None) -> None:
        super().__init__(episodes.model, 1, episodes.period, np.empty(0), episodes.sensors)
        self.robot, self.pacer, self._log, self._rise, self._still = robot, Pacer(robot.clock, episodes.period), log, rise, still
        self._window = max(WINDOW, np.pi / (RESOLVED * linear_rate(episodes.model)))  # [s], half a swing, which stands still where it turns
        self._is_there = self._has_zeros = is_there
        self._command, self._actuation = episodes.start_command, episodes.actuation
        self.zero: dict[str, Array] = {}
        """Values by field that are added to what the robot measures, so that it reads as the model at rest."""

    def place(self, members: Indices, q: Array, tension: Array | None = None) -> None:
        """Let the robot begin, from slack tendons. Raises RobotStopped, also where it does not come to rest."""
        super().place(members, q, tension)
        self.robot.begin()
        self.pacer.start()
        self.zero = {}
        if self._is_there:
            self.robot.write(self._command)
            held = [self.robot.read()]
        else:
            held = self._at_rest()
            rest = {name: getattr(self.reading, name)[0].copy() for name in ("tendon_length", "strain") if name in self.robot.senses}
            if not self._has_zeros:
                self.zero = {name: value - np.mean([getattr(at, name) for at in held], axis=0) for name, value in rest.items()}
            self.pacer.start()
        self._is_there = False
        self._take(held[-1])
        if self._log is not None:
            self._log.begin(self.pacer.period, self._zeroed(held[-2:][0]), self._command)

    def step(self, command: Array, members: Indices, durations: Array | None = None, tape: Tape | None = None, begins: bool = True) -> None:
        """Send the command of a period (1, parts, n_a), which becomes what was sent, and measure at its end. Raises RobotStopped."""
        asked = command[0, -1].copy()
        sent = self.robot.write(asked)
        if self._log is not None:
            try:
                self._log.append(self.pacer.period * self.pacer.count, self._now, asked, sent)
            except OSError as error:
                self.robot.fail(f"the log {self._log.path} cannot be written: {describe(error)}")
        command[:], self._actuation.command[0] = sent, sent
        super().step(command, members, durations, tape)  # one that begins, whatever was asked
        self.outcome.status[:] = OK  # a robot does not diverge
        self.robot.look_at_lateness(self.pacer.wait())
        self._take(self.robot.read())

    def _at_rest(self) -> list[Measurement]:
        """The last readings of the arm at rest under the first command, which rises evenly from slack. Raises RobotStopped."""
        period, slack = self.pacer.period, self.robot.slack
        rise, window = max(round(self._rise / period), 1), max(round(self._window / period), READINGS)
        held, was_still = deque[tuple[int, Measurement]](), False  # new ones, by their period
        for k in itertools.count(1 - rise):
            self.robot.write(slack + min((k + rise) / rise, 1.0) * (self._command - slack))
            self.pacer.wait()
            measured = self.robot.read()
            if k > 0 and (not held or measured.time != held[-1][1].time):
                held.append((k, measured))
            while len(held) > READINGS and held[0][0] <= k - window:
                held.popleft()
            if k < window or k % max(window // LOOKS, 1) or len(held) < READINGS:
                continue
            positions = np.array([at.tip_pose[:3, 3] for _, at in held if at.tip_pose is not None])
            speed = speed_of(positions, period * (held[-1][0] - held[0][0]) / (len(held) - 1))
            if speed <= self._still and was_still:
                break
            was_still = speed <= self._still
            if period * k >= WAIT and not was_still:
                text = f"the arm does not come to rest: its tip moves at {speed:.3g} m/s, {period * k:g} s after the first command"
                self.robot.fail(f"{text}; at rest it is at most {self._still:.3g} m/s. Allow more, by rest_speed, or damp the arm")
        return [at for _, at in held]

    def _zeroed(self, measured: Measurement) -> Measurement:
        """A measurement with the zeros of the arm at rest."""
        return measured._replace(**{name: getattr(measured, name) + zero for name, zero in self.zero.items()})

    def _take(self, measured: Measurement) -> None:
        """Make a measurement the reading, with the zeros of the arm at rest."""
        self._now = self._zeroed(measured)
        self.reading.tension[:] = np.nan  # unless it is measured
        for name in self.robot.senses:
            getattr(self.reading, name)[0] = getattr(self._now, name)


def misfit(robot: Robot, episodes: Episodes) -> str:
    """Reason why a robot cannot play an environment's episodes; "": it can."""
    senses, options, groups = {*robot.senses}, episodes.options, episodes.layout.slices
    if robot.command_unit != (unit := episodes.model.command_unit):
        return f"which takes {robot.command_unit!r}, and the scene's arm takes {unit!r}: see [effects.tendon_elasticity]"
    if options.randomize.numbers or options.randomize.of_actuators or options.randomize.latency != (0.0, 0.0):
        return "as it is: the option randomize should have no more than the noise of its sensors, for policies that know of it"
    needed = {**{FIELDS[name]: name for name in groups if name in FIELDS}, "tip_pose": "the errors of the task"}
    needed |= {"tip_twist": "the option tip_speed_limit"} if options.tip_speed_limit is not None else {}
    if missing := [f"{name} ({why})" for name, why in needed.items() if name not in senses]:
        return f"without {', '.join(missing)}, which is observed. Controllers behind a state estimator: filtered:NAME"
    if episodes.task.shapes or (odd := [name for name in groups if name not in {*FIELDS, *TARGET_GROUPS, HISTORY}]):
        return f"measured at its tip and by its sensors alone{'' if episodes.task.shapes else ': not ' + ', '.join(odd)}"
    return ""


def speed_of(position: Array, period: float) -> float:
    """Speed [m/s], root mean square, of a point measured at positions (m, 3) [m] one period [s] apart.

    Differences of noisy samples are mostly noise: 1 mm at 50 Hz makes 70 mm/s. So the motion is that of the cosine modes that stand out of
    the noise, whose power is about the same in all modes.
    """
    power = scipy.fft.dct(position, axis=0, norm="ortho")[1:] ** 2 / len(position)
    power = np.sum(power, axis=1, where=power > STANDS_OUT * np.median(power, axis=0))
    rate = np.pi * np.arange(1, len(position)) / (len(position) * period)
    return float(np.sqrt(np.sum(rate**2 * power)))
