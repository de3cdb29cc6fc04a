"""Robots for tests: an arm that answers as it is told to, and environments for it."""

import threading
import time

import gymnasium as gym
import numpy as np
import pytest

from soft_tendon_env.robots import Measurement, safety, slack
from soft_tendon_env.robots.clock import Clock

POSE = np.eye(4)
POSE[0, 3] = 0.3
LONGEST = 1800.0
"""Real time [s] that a busy machine does not take: what lasts longer hangs."""


@pytest.fixture(autouse=True)
def patient(monkeypatch):
    """Slack is tried for as long as a busy machine may take over it."""
    for module in (slack, safety):
        monkeypatch.setattr(module, "TRYING", 30.0)


@pytest.fixture(scope="session")
def wait_until():
    """wait_until(holds): returns as soon as `holds()`."""

    def wait(holds):
        until = time.monotonic() + LONGEST
        while not holds():
            assert time.monotonic() < until
            time.sleep(0.01)

    return wait


class WatchedClock(Clock):
    """Stepped time that the watchdog looks at, as it does at real time."""

    def __init__(self):
        super().__init__(real=False)
        self.real = True

    def now(self):
        return max(self._times.values())

    def wait_until(self, time):
        self._times[threading.get_ident()] = max(time, self.now())


class Arm:
    """A motionless arm of three tendons, in stepped time, that keeps what it was sent, and when.

    faults: functions by the name of a method, called before it with its count; what they raise, it
    raises. is_watched: whether the watchdog looks at the time.
    """

    command_unit = "N"
    senses = ("tip_pose", "tendon_length")

    def __init__(self, is_watched=False, **faults):
        if is_watched:
            self.clock = WatchedClock()
        else:
            self.clock = Clock(real=False)
        self.faults = faults
        self.counts = {"read": 0, "write": 0}
        self.sent = []
        self.closed = False

    def _fault(self, name):
        self.counts[name] += 1
        if name in self.faults:
            self.faults[name](self.counts[name])

    def read(self):
        self._fault("read")
        return Measurement(self.clock.now(), tip_pose=POSE, tendon_length=np.array([0.1, 0.2, 0.3]))

    def write(self, command):
        self._fault("write")
        self.sent.append((self.clock.now(), command.copy()))
        return command

    def close(self):
        self.closed = True

    @property
    def is_slack(self):
        return not self.sent[-1][1].any()


@pytest.fixture(scope="session")
def arm_of_test():
    """The class Arm."""
    return Arm


@pytest.fixture(scope="session")
def columns_of_log():
    """columns_of_log(path): numbers of a log by the names of its columns, without the row at
    rest."""
    return lambda path: np.genfromtxt(path, delimiter=",", names=True)[1:]


class Pulling:
    """A policy that pulls, and does `then(count)` before it."""

    def __init__(self, then=lambda count: None):
        self.count = 0
        self.then = then

    def predict(self, observation, state=None, episode_start=None, deterministic=True):
        self.count += 1
        self.then(self.count)
        return np.array([0.5, -0.5, 0.0], dtype=np.float32), None


@pytest.fixture(scope="session")
def pulling():
    """The class Pulling."""
    return Pulling


@pytest.fixture
def drawing():
    """drawing(task="TipPose", **options): an environment of three tendons that observes what `Arm`
    senses, unless options say otherwise.

    Everything is compiled, as after a rehearsal.
    """

    def make(task="TipPose", **options):
        observed = (
            "tip_position",
            "tip_rotation",
            "tendon_lengths",
            "target_error",
            "preview",
            "last_action",
            "command",
        )
        usual = {
            "scene": "three_tendon",
            "fidelity": "fast",
            "action": "tension",
            "observation": observed,
        }
        env = gym.make(f"TendonRod-{task}-v0", **{**usual, **options})
        env.reset(seed=0)
        env.step(np.zeros(3))
        return env

    return make
