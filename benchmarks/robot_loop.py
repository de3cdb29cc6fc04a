"""Jitter of the control loop in real time, and the time from every fault to slack tendons.

    python benchmarks/robot_loop.py [--seconds 20] [--policy filtered:tracking] [--out out]

The robot is a simulated arm in this process. A fault happens half a second after the beginning of a
run of its own; "from the fault" counts from there to the last command, which lets the tendons go,
and "from its notice" from when the watchdog or the loop saw it.
"""

import argparse
import math
import threading
from collections.abc import Callable
from pathlib import Path
from time import perf_counter

import gymnasium as gym
import matplotlib.pyplot as plt
import numpy as np
from _results import machine, markdown_table, write_csv, write_picture

from soft_tendon_env.evaluation.settings import episode_steps
from soft_tendon_env.policies import Policy, load_policy, policy_options
from soft_tendon_env.robots import Report, RobotEnv, SimulatedRobot, rehearse, run_policy

ARM = {"scene": "three_tendon", "fidelity": "standard"}
TASK = "TipPose"
HEADER = (
    "run",
    "periods",
    "overruns",
    "late, p50 [ms]",
    "p99 [ms]",
    "worst [ms]",
    "from its notice [ms]",
    "from the fault [ms]",
    "rows logged",
    "stopped by",
)
HANGS = 0.5  # [s], longer than any patience
FAULTS = (
    "tracker lost",
    "port lost",
    "NaN measured",
    "reading hangs",
    "policy hangs",
    "policy raises",
    "Ctrl-C",
)


class Faulty(SimulatedRobot):
    """A simulated robot with one of FAULTS, or none, from `begins` [s] of its clock on. `slack_at`:
    when the last command was slack."""

    fault = ""
    begins = math.inf
    slack_at = math.nan

    def read(self):
        measured = super().read()
        if perf_counter() >= self.begins:
            if self.fault == "tracker lost":
                return measured._replace(time=self.begins)
            if self.fault == "NaN measured":
                return measured._replace(tip_pose=np.full((4, 4), np.nan))
            if self.fault == "port lost":
                raise OSError(5, "Input/output error", "/dev/ttyUSB0")
            if self.fault == "reading hangs":
                threading.Event().wait(HANGS)
        return measured

    def write(self, command):
        sent = super().write(command)
        self.slack_at = math.nan if command.any() else perf_counter()
        return sent


class Failing:
    """A policy that fails as its robot's fault says."""

    def __init__(self, policy: Policy, robot: Faulty) -> None:
        self._policy = policy
        self._robot = robot

    def predict(self, observation, state=None, episode_start=None, deterministic=True):
        if perf_counter() >= self._robot.begins:
            if self._robot.fault == "policy hangs":
                threading.Event().wait(HANGS)
            if self._robot.fault == "policy raises":
                raise ValueError("the policy failed")
            if self._robot.fault == "Ctrl-C":
                raise KeyboardInterrupt
        return self._policy.predict(observation, state, episode_start, deterministic)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seconds", type=float, default=20.0)
    parser.add_argument("--policy", default="filtered:tracking")
    parser.add_argument("--out", type=Path, default=Path("out"))
    arguments = parser.parse_args()
    print(f"{machine()}; {arguments.policy} at 50 Hz\n")
    arguments.out.mkdir(parents=True, exist_ok=True)
    rows = [
        row_of("no fault", arguments, arguments.seconds),
        *(row_of(fault, arguments, 2.0) for fault in FAULTS),
    ]
    print(markdown_table(HEADER, rows))
    write_csv(arguments.out / "robot_loop.csv", HEADER, rows)
    draw(rows[1:], arguments.out / "robot_loop.png")


def row_of(fault: str, arguments: argparse.Namespace, seconds: float) -> tuple[object, ...]:
    """Results of a run with a fault."""
    steps = episode_steps(seconds, 0.0, ARM)
    options = policy_options(arguments.policy, TASK, ARM)
    env = gym.make(f"TendonRod-{TASK}-v0", max_episode_steps=steps, **options)
    policy = load_policy(arguments.policy, env)
    rehearse(policy, env)
    robot = Faulty(**ARM, sensors=options.get("sensors", 0), randomize={"stiffness": 0.8})
    log = arguments.out / f"robot_{fault.replace(' ', '_')}.csv"
    log.unlink(missing_ok=True)
    real = RobotEnv(env, robot, settle=0.0, log=log)  # it is at rest
    if fault in FAULTS:
        robot.fault = fault
        robot.begins = perf_counter() + 1.0
    report = ended(lambda: run_policy(Failing(policy, robot), real, seconds), real)
    since = f"{1e3 * (robot.slack_at - robot.begins):.0f}" if fault in FAULTS else "-"
    timing = report.timing
    noticed = 1e3 * report.stop.seconds
    logged = log.read_text().count("\n") - 2 if log.exists() else 0
    late = [f"{1e3 * value:.3f}" for value in (timing.p50, timing.p99, timing.worst)]
    return (
        fault,
        timing.periods,
        timing.overruns,
        *late,
        f"{noticed:.0f}",
        since,
        logged,
        report.stop.cause,
    )


def ended(run: Callable[[], Report], real: RobotEnv) -> Report:
    """Report of a run, also of one that raises."""
    try:
        return run()
    except (ValueError, KeyboardInterrupt):
        return Report({}, real.unwrapped.episodes.arms.pacer.timing, real.stop("it has ended"))


def draw(rows: list[tuple[object, ...]], path: Path) -> None:
    """A bar for each fault."""
    figure, axes = plt.subplots(figsize=(6.4, 3.2), layout="constrained")
    axes.barh(
        [str(row[0]) for row in rows],
        [float(str(row[HEADER.index("from the fault [ms]")])) for row in rows],
    )
    axes.set(xlabel="from the fault to slack tendons [ms]")
    axes.invert_yaxis()
    write_picture(figure, path, dpi=150)


if __name__ == "__main__":
    main()
