"""Simulated arm behind the interface of a real one, in real or in simulated time.

It has noise, latency, rate limits and model errors.
"""

from collections import deque
from typing import Any

import numpy as np

from soft_tendon_env.envs.episodes import Episodes
from soft_tendon_env.envs.options import Options, given_scene
from soft_tendon_env.envs.randomization import Sensors
from soft_tendon_env.envs.tasks import TASKS
from soft_tendon_env.mechanics.motion.status import OK
from soft_tendon_env.model.simulation import SimulationDiverged
from soft_tendon_env.policies.regimes import SENSORS
from soft_tendon_env.robots.clock import Clock
from soft_tendon_env.robots.protocol import Measurement, Unit
from soft_tendon_env.tools.checks import checked_array, checked_count
from soft_tendon_env.tools.configuration import ConfigurationError, Problem, not_among
from soft_tendon_env.tools.types import Array

# options that say what an arm is like
OF_ARM = ("scene", "fidelity", "tension_limits", "sensors", "randomize", "control_period")
ROW = np.zeros(1, dtype=np.int64)
EARLY = 1e-9  # [s] by which a command may arrive before its time: clocks are sums


class SimulatedRobot:
    """Simulated arm as a robot.

    It rests under the tensions nearest to zero until the first call, and each call simulates it up
    to the present. It measures every field of Measurement except tensions. Rate limits and lag are
    those of the scene's [effects.actuators].

    Args:
        seed: of the arm, drawn once, and of noise.
        real_time: whether time passes by itself; else it passes only while a loop waits.
        options: those of environments in OF_ARM, `randomize` for model errors among them.

    Raises:
        ConfigurationError: for unknown keys and values that are not allowed.
        TypeError: for a seed that is no whole number.
        ValueError: for a negative seed.
    """

    senses = ("tip_pose", "tip_twist", "tendon_length", "strain", "strain_rate")

    def __init__(self, seed: int = 0, real_time: bool = True, **options: Any) -> None:
        unknown = [name for name in options if name not in OF_ARM]
        if unknown:
            problems = [
                Problem((name,), f"is an unknown key: {not_among(name, OF_ARM)}")
                for name in unknown
            ]
            raise ConfigurationError(problems, "SimulatedRobot")
        # a target costs nothing, and nobody sees it
        target = {"type": "hold", "pose": np.eye(4).tolist()}
        values = {"sensors": SENSORS, **options, "target": target}
        parsed = Options.parse(values, "SimulatedRobot")
        # the delay is taken here, where commands come as often as they like
        scene = given_scene(parsed.scene)
        delay = getattr(scene.effects.actuators, "delay", 0.0)
        if delay:
            undelayed = {"scene": parsed.scene, "effects.actuators.delay": 0.0}
            parsed = parsed.model_copy(update={"scene": undelayed})
        episodes = Episodes(TASKS["TipPose"], parsed, rows=1)
        self._episodes = episodes
        self._arms = episodes.arms
        self._actuation = episodes.actuation
        if episodes.model.command_unit == "m":
            self.command_unit: Unit = "m"
        else:
            self.command_unit = "N"
        self.clock = Clock(real_time)
        first = episodes.start_command
        drawn = episodes.options.randomize
        self._sensors = Sensors(
            drawn.noise,
            rows=1,
            tendons=first.size,
            sensors=episodes.sensors.size,
            omit=drawn.omission("noise"),
        )
        self._readings = np.zeros(1, dtype=np.int64)
        # these two compile, so that no reading waits for that
        commands = first[None, None]
        self._arms.step(commands, ROW)
        self._sensors.measured(self._arms.reading, self._readings, ROW)
        checked_seed = checked_count("seed", seed, 0)
        generators = [np.random.default_rng(checked_seed)]
        episodes.begin(ROW, generators)
        own_delay = self._actuation.delay(0)
        self._latency = delay + own_delay
        self._acting = self._actuation.acting(first, 0)
        self._coming = deque[tuple[float, Array]]()  # commands by the time when they arrive [s]
        self._time = np.inf  # [s] of the arm, once it moves
        self._sensors.begin(0, seed)

    def read(self) -> Measurement:
        """Simulates the arm up to now, and measures it.

        Returns:
            The measurement, with noise.

        Raises:
            SimulationDiverged: where the simulation does not go on.
        """
        time = self._go_on()
        noisy = self._sensors.measured(self._arms.reading, self._readings, ROW)
        self._readings += 1
        fields = {}
        for name in noisy._fields:
            of_row = getattr(noisy, name)[0]
            fields[name] = of_row.copy()
        twist = self._arms.reading.tip_twist[0]
        tip_twist = twist.copy()
        return Measurement(time, tip_twist=tip_twist, **fields)

    def write(self, command: Array) -> Array:
        """Sends a command that will arrive after the latency.

        Args:
            command: (n_a,) in the unit `command_unit`.

        Returns:
            The command as it was sent, (n_a,).

        Raises:
            TypeError: for what is no array of numbers.
            ValueError: for other shapes.
            SimulationDiverged: where the simulation does not go on.
        """
        sent = checked_array("command", command, self._acting.shape)
        arrival = self._go_on() + self._latency
        order = (arrival, self._actuation.acting(sent, 0))
        self._coming.append(order)
        return sent

    def close(self) -> None:
        """Does nothing: a simulated arm has no motors."""

    def _go_on(self) -> float:
        """Simulates up to now; returns that time [s]."""
        now = self.clock.now()
        time = min(now, self._time)
        while True:
            while self._coming and self._coming[0][0] <= time + EARLY:
                _, self._acting = self._coming.popleft()
            # in steps of a control period at most, to the next command
            if self._coming:
                next_arrival = self._coming[0][0]
            else:
                next_arrival = now
            period_end = time + self._episodes.period
            until = min(now, period_end, next_arrival)
            duration = until - time
            if duration <= EARLY:
                break
            commands = self._acting[None, None]
            durations = np.array([[duration]])
            self._arms.step(commands, ROW, durations)
            code = self._arms.outcome.status[0]
            if code != OK:
                raise SimulationDiverged(
                    self._episodes.state(0),
                    self._episodes.cause(0),
                    self._acting,
                    self.command_unit,
                )
            time = until
        self._time = now
        return now
