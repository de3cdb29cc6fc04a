"""Real arm in place of a simulated one: an environment's `Arms` whose steps command a robot and whose reading is what it measures.

The simulated arm goes on beside it under the commands that were sent: it is what recordings show, and nothing of it is observed.
"""

from collections.abc import Mapping

import numpy as np

from soft_tendon_env.envs.arms import Arms, Indices
from soft_tendon_env.envs.contacts import encountered
from soft_tendon_env.envs.episodes import Episodes
from soft_tendon_env.envs.observation import HISTORY
from soft_tendon_env.envs.tasks import TIP
from soft_tendon_env.mechanics.motion.status import OK
from soft_tendon_env.mechanics.motion.tape import Tape
from soft_tendon_env.policies.estimators import PARAMETERS
from soft_tendon_env.policies.regimes import TARGET_GROUPS
from soft_tendon_env.robots.clock import Pacer
from soft_tendon_env.robots.log import RobotLog
from soft_tendon_env.robots.protocol import COMMANDS, Measurement, Robot
from soft_tendon_env.robots.safety import SafeRobot
from soft_tendon_env.tools.types import Array

FIELDS: Mapping[str, str] = {**dict.fromkeys(TIP, "tip_pose"), **PARAMETERS}
"""Fields of a Measurement by the observation groups that are made of them."""
STILL = 0.5
"""Share of the time to settle in which the arm is held still; before that the command rises evenly."""


class MeasuredArm(Arms):
    """One row, the robot. `place` brings it to where episodes begin, and makes that the zero of lengths and strains.

    Args:
        episodes: of the environment, begun never.
        robot: see SafeRobot.
        settle: time [s] to get there and come to rest; 0: it is there, and its sensors have their zeros.
        log: of every period, or None.
    """

    def __init__(self, episodes: Episodes, robot: SafeRobot, settle: float, log: RobotLog | None) -> None:
        super().__init__(episodes.model, 1, episodes.period, np.empty(0), episodes.sensors)
        self.robot, self.pacer, self._log, self._settle = robot, Pacer(robot.clock, episodes.period), log, settle
        self._command, self._actuation = episodes.start_command, episodes.actuation
        self.zero: dict[str, Array] = {}
        """Values by field that are added to what the robot measures, so that it reads as the model at rest."""

    def place(self, members: Indices, q: Array, tension: Array | None = None) -> None:
        """Let the robot begin, from slack tendons. Raises RobotStopped."""
        super().place(members, q, tension)
        rest = {name: getattr(self.reading, name)[0].copy() for name in ("tendon_length", "strain")}
        self.robot.begin()
        self.pacer.start()
        self.zero = {}
        if self._settle:
            held = self._settled()
            self.zero = {
                name: rest[name] - np.mean([getattr(own, name) for own in held], axis=0) for name in rest if name in self.robot.senses
            }
            self.pacer.start()
        else:
            self.robot.write(self._command)
        self._take(self.robot.read())
        if self._log is not None:
            self._log.begin(self.pacer.period, self._now, self._command)

    def step(self, command: Array, members: Indices, durations: Array | None = None, tape: Tape | None = None) -> None:
        """Send the command of a period (1, parts, n_a), which becomes what was sent, and measure at its end. Raises RobotStopped."""
        asked = command[0, -1].copy()
        sent = self.robot.write(asked)
        if self._log is not None:
            self._log.append(self.pacer.period * self.pacer.count, self._now, asked, sent)
        command[:], self._actuation.command[0] = sent, sent
        super().step(command, members, durations, tape)
        self.outcome.status[:] = OK  # a robot does not diverge
        self.robot.look_at_lateness(self.pacer.wait())
        self._take(self.robot.read())

    def _settled(self) -> list[Measurement]:
        """Measurements of the arm held at the first command, to which it is brought from slack."""
        periods = max(2, round(self._settle / self.pacer.period))
        held = []
        for k in range(1, periods + 1):
            share = min(k / ((1.0 - STILL) * periods), 1.0)
            self.robot.write(self.robot.slack + share * (self._command - self.robot.slack))
            self.pacer.wait()
            measured = self.robot.read()
            held += [measured] if 2 * k > (2.0 - STILL) * periods else []  # the last of those at which it is still
        return held

    def _take(self, measured: Measurement) -> None:
        """Make a measurement the reading, with the zeros of the arm at rest."""
        self._now = measured._replace(**{name: getattr(measured, name) + zero for name, zero in self.zero.items()})
        self.reading.tension[:] = np.nan  # unless it is measured
        for name in self.robot.senses:
            getattr(self.reading, name)[0] = getattr(self._now, name)


def misfit(robot: Robot, episodes: Episodes) -> str:
    """Reason why a robot cannot play an environment's episodes; "": it can."""
    unit, senses = episodes.model.command_unit, set(robot.senses)
    if robot.command_unit != unit:
        driven = f"{COMMANDS[robot.command_unit]}-driven, and the scene's arm is driven by {COMMANDS[unit]}s"  # type: ignore[index] # N or m
        return f"{driven}: give the scene [effects.tendon_elasticity], or take it away"
    drawn = episodes.options.randomize
    if drawn.of_arm or drawn.of_actuators or drawn.latency != (0.0, 0.0):
        return "as it is: the option randomize should have no more than the noise of its sensors, for policies that know of it"
    if episodes.task.shapes:
        return f"measured at its tip and by its sensors alone, and {episodes.task.name} compares shapes of the whole arm"
    if encountered(episodes.model):
        return "unable to measure contact: take the obstacles, effects.contact, out of the scene"
    if episodes.options.tip_speed_limit is not None and "tip_twist" not in senses:
        return "without a measured tip_twist, which the option tip_speed_limit needs"
    needed = {**{FIELDS[name]: name for name in episodes.layout.slices if name in FIELDS}, "tip_pose": "the errors of the task"}
    if missing := [f"{name} ({why})" for name, why in needed.items() if name not in senses]:
        found = not {"q", "q_dot", "tip_twist", "strain_rate"}.isdisjoint(needed.keys() - senses)
        hint = " Controllers behind a state estimator: filtered:NAME" if found else ""
        return f"without {', '.join(missing)}, which is observed.{hint}"
    known = {*FIELDS, *TARGET_GROUPS, HISTORY}
    odd = [name for name in episodes.layout.slices if name not in known]
    return f"unable to measure the observation groups {', '.join(odd)}" if odd else ""
