"""A robot that is another simulator: an arm that nobody has identified yet, behind the robots'
protocol.

foreign_mujoco.py, foreign_elastica.py and foreign_soromox.py have one in a simulator each. From
this folder: soft-tendon collect three_tendon --robot foreign_mujoco:MujocoArm ...
docs/tutorials/foreign_arm.md has all commands, and what comes of them. Its table:
python foreign_arm.py filtered:predictive out/identified/scene.toml --robot foreign_mujoco:MujocoArm
"""

import argparse
import importlib
from collections import deque

import gymnasium as gym
import numpy as np
from scipy.spatial.transform import Rotation

import soft_tendon_env as ste
from soft_tendon_env.policies import load_policy, policy_options
from soft_tendon_env.robots import Measurement, RobotEnv, SimulatedRobot, rehearse, run_policy
from soft_tendon_env.robots.clock import Clock

DRAWING = "three_tendon"
GRAVITY = [9.81, 0.0, 0.0]  # [m/s^2]: the arm hangs
LATENCY = 0.03  # [s] from a command to its tension
NOISE = {"position": 5e-4, "rotation": 0.005, "length": 2e-4}  # [m], [rad], [m]
# what the arm measures, and what is asked of it: it has no strain sensors
OBSERVED = ("tip_position", "tip_rotation", "tendon_lengths", "target_error", "preview")
SKIP = 1.0  # [s] at the beginning of a run that errors leave out
EARLY = 1e-9  # [s] by which a command may arrive before its time: clocks are sums


def unknown_scene(random):
    """The drawing with what nobody tells: its material, its section, its tendons and its stand."""
    drawing = ste.load_scene(DRAWING)
    material = drawing.segments[0]
    distance = random.uniform(0.95, 1.05)  # of the tendons from the axis, of the drawn one
    changes = {
        "effects.gravity.acceleration": GRAVITY,
        "segments.0.young_modulus": material.young_modulus * random.uniform(0.6, 1.5),
        "segments.0.damping": material.damping * random.uniform(0.5, 1.5),
        "segments.0.density": material.density * random.uniform(0.9, 1.15),
        "segments.0.radius": material.radius * random.uniform(0.97, 1.03),
        "base.rotation": random.normal(scale=2.0, size=3).tolist(),  # [deg]
    }
    for i, tendon in enumerate(drawing.tendons):
        offset = distance * np.array(tendon.routing.offset)
        changes[f"tendons.{i}.routing.offset"] = offset.tolist()
    return drawing.replace(changes)


class ForeignArm:
    """An arm of another simulator, measured with noise, whose commands come late.

    It is simulated up to the present whenever somebody calls. A simulator has its time `step` [s],
    `advance` by a number of steps under tensions [N], `tip_pose` and `tendon_length` [m].
    """

    command_unit = "N"
    senses = ("tip_pose", "tendon_length")

    def __init__(self, seed=0, real_time=False):
        self.clock = Clock(real_time)
        random = np.random.default_rng(seed)
        self.scene = unknown_scene(random)  # for the simulator alone
        self._noise = random
        self._tension = np.zeros(len(self.scene.tendons))
        self._coming = deque()  # (time of arrival [s], tensions)
        self._time = None  # [s], once somebody has called

    def read(self):
        time = self._go_on()
        pose = self.tip_pose()
        turn = Rotation.from_rotvec(self._noise.normal(scale=NOISE["rotation"], size=3))
        pose[:3, :3] = pose[:3, :3] @ turn.as_matrix()
        pose[:3, 3] += self._noise.normal(scale=NOISE["position"], size=3)
        length = self.tendon_length()
        length += self._noise.normal(scale=NOISE["length"], size=length.size)
        return Measurement(time, tip_pose=pose, tendon_length=length)

    def write(self, command):
        self._coming.append((self._go_on() + LATENCY, command.copy()))
        return command

    def close(self):
        pass

    def _go_on(self):
        """Simulate up to now, from one arrival of a command to the next; returns the time [s]."""
        now = self.clock.now()
        if self._time is None:
            self._time = now
        while self._coming and self._coming[0][0] <= now + EARLY:
            arrival, tension = self._coming.popleft()
            self._advance_to(arrival)
            self._tension = tension
        self._advance_to(now)
        return now

    def _advance_to(self, time):
        """Whole steps of the simulator, as many as the time [s] has; the rest comes next time."""
        steps = round((time - self._time) / self.step)
        if steps > 0:
            self.advance(self._tension, steps)
            self._time += steps * self.step


def position_errors(policy_name, arm, make_robot, seeds, seconds):
    """Root mean square error of the tip [m] in each run, and how the tendons were let go.

    The tracker's noise is taken out of it: it is independent of where the tip is.
    """
    options = policy_options(policy_name, "TipPose", arm)
    errors = []
    stops = []
    for seed in seeds:
        env = gym.make("TendonRod-TipPose-v0", **options)
        policy = load_policy(policy_name, env)
        rehearse(policy, env)
        robot = make_robot(seed, options.get("sensors", ()))
        real = RobotEnv(env, robot)
        report = run_policy(policy, real, seconds, seed)
        if not report.finished:
            raise RuntimeError(report.stop.cause)
        after = round(SKIP / env.unwrapped.episodes.period)
        measured = np.mean(report.errors["position_error"][after:] ** 2)
        of_tracker = 3.0 * NOISE["position"] ** 2
        errors.append(np.sqrt(max(measured - of_tracker, 0.0)))
        stops.append(report.stop.slack)
    return np.array(errors), all(stops)


def main():
    parser = argparse.ArgumentParser(description="A policy on the foreign and the identified arm.")
    parser.add_argument("policy", help="filtered:predictive, or the folder of an agent")
    parser.add_argument("scene", help="of identification")
    parser.add_argument("--robot", default="foreign_mujoco:MujocoArm", help="MODULE:CLASS")
    parser.add_argument("--import", dest="modules", nargs="*", default=[], help="of own effects")
    parser.add_argument("--seeds", type=int, default=5, help="targets")
    parser.add_argument("--seconds", type=float, default=10.0)
    chosen = parser.parse_args()
    for module in chosen.modules:
        importlib.import_module(module)
    module, _, name = chosen.robot.partition(":")
    foreign_class = getattr(importlib.import_module(module), name)
    arm = {"scene": chosen.scene, "fidelity": "fast", "randomize": {"noise": NOISE}}
    length = ste.build_model(ste.load_scene(chosen.scene), "fast").length

    def foreign(seed, sensors):
        return foreign_class()

    def identified(seed, sensors):
        return SimulatedRobot(seed, real_time=False, sensors=sensors, **arm)

    interface = {}
    if chosen.policy.startswith("filtered:"):  # agents say what they observe
        interface["observation"] = OBSERVED
    for title, make_robot in (("foreign", foreign), ("identified", identified)):
        errors, are_slack = position_errors(
            chosen.policy, {**arm, **interface}, make_robot, range(chosen.seeds), chosen.seconds
        )
        share = 100.0 * errors / length
        tendons = "slack" if are_slack else "not slack"
        print(
            f"{chosen.policy} on the {title} arm: {1e3 * errors.mean():.2f} mm,"
            f" {share.mean():.2f} % of the length, worst {share.max():.2f} %; tendons {tendons}"
        )


if __name__ == "__main__":
    main()
