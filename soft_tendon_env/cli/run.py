"""`soft-tendon run`: a policy on a robot, real, simulated or replayed, with a log and a report of its timing."""

import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
from pydantic import Field

from soft_tendon_env.cli.errors import require
from soft_tendon_env.cli.options import Parser
from soft_tendon_env.envs import IDS
from soft_tendon_env.envs.episodes import episodes_of
from soft_tendon_env.envs.tracking import error_unit
from soft_tendon_env.evaluation.metrics import root_mean_square
from soft_tendon_env.evaluation.provenance import machine
from soft_tendon_env.evaluation.settings import EpisodeSettings, Seed, TaskName, episode_steps
from soft_tendon_env.model.inverse_statics import tension_for_tip_position
from soft_tendon_env.policies.names import PolicyName
from soft_tendon_env.recording import RecordRollout
from soft_tendon_env.robots.environment import PATIENCE, SETTLE, RobotEnv, robot_of
from soft_tendon_env.robots.log import check_log
from soft_tendon_env.robots.measured_arm import REST, Rest
from soft_tendon_env.robots.protocol import DryRobot, Robot, load_robot
from soft_tendon_env.robots.run import Report, rehearse, run_policy
from soft_tendon_env.robots.simulated import OF_ARM
from soft_tendon_env.tools.messages import UserError
from soft_tendon_env.tools.types import NotNegative, Positive

SIMULATED = "soft_tendon_env.robots:SimulatedRobot"
LOOKS, NEAR = 5, 0.02
"""Number of times at which it is asked whether the target is within reach, and how near the tip should come, in lengths of the arm."""


class Run(EpisodeSettings):
    """Run a policy on a robot in real time, print its errors as measured and the jitter of the loop, and write a log and a report.

    Attributes:
        policy: a controller's name behind filtered: or adaptive:, an agent's folder or .zip file, agent, ppo, sac, dagger or apg, or
            module:name.
        robot: class of the robot, MODULE:CLASS; by default a simulated arm, as the environment's options say, in real time.
        robot_options: keyword arguments of that class.
        task: name of the task: TipPose, Reach, or one that was registered.
        seed: of the target.
        rate: greatest change of a command in a second [N/s], with displacement-driven arms [m/s]; any by default.
        settle: time [s] to bring the arm to the pretension; at rest there, lengths and strains get their zeros. 0 where it is there.
        rest_speed: greatest speed of the tip of an arm at rest, as a share of the arm's length per second.
        rest_wait: longest time [s] for which rest is waited for.
        patience: control periods without a new reading, or behind the deadlines, after which the tendons go slack.
        dry_run: send nothing to the robot, and read alone.
        record: file for the Rerun viewer: what is measured of the tip over the arm as it is simulated under the commands that were sent.
        out: log, a new .csv file; the report is the .json file beside it.
    """

    policy: str
    robot: str = SIMULATED
    robot_options: dict[str, Any] = Field(default={})
    task: TaskName = "TipPose"
    seed: Seed = 0
    rate: Positive | None = None
    settle: NotNegative = SETTLE
    rest_speed: Positive = REST.speed
    rest_wait: NotNegative = REST.wait
    patience: int = Field(default=PATIENCE, ge=1)
    dry_run: bool = False
    record: str | None = None
    out: str = "out/run.csv"


def run(arguments: Sequence[str]) -> None:
    """Run, print and write. Raises UserError where the robot was stopped before the end."""
    parser = Parser("run", Run)
    settings = parser.read(arguments)
    out, task = Path(settings.out), settings.task
    with parser.mistakes():
        if settings.record is not None:
            require("recording")
        check_log(out)
        steps = episode_steps(settings.seconds, settings.skip, settings.options)
        named = PolicyName.parse(settings.policy, task)
        options = named.options(settings.options)
        env = gym.make(IDS[task], max_episode_steps=steps, **options)
        policy = named.load(env)
        rehearse(policy, env, settings.seed)
        _tell_of_reach(env, settings.seconds)
        real = _connected(settings, env, options)
    print(f"{settings.policy} on {settings.robot}, {settings.seconds:g} s; {machine()}\n")
    try:
        report = run_policy(policy, real, settings.seconds, settings.seed, out.with_suffix(".json"))
    finally:  # also after Ctrl-C
        if out.exists():
            print(f"written: {out}")
        if stop := robot_of(real).stopped:
            let_go = "slack" if stop.slack else f"not slack, the robot does not answer: {stop.failures[-1]}"
            print(f"{stop.cause}: tendons {let_go} after {1e3 * stop.seconds:.0f} ms\n")
    _tell(report, round(settings.skip / episodes_of(real).period))
    if not report.finished:
        raise UserError(f"the robot was stopped: {report.stop.cause}")


def _connected(settings: Run, env: gym.Env[Any, Any], options: dict[str, Any]) -> gym.Env[Any, Any]:
    """The environment, with these options, and its robot. Raises ValueError, TypeError, OSError, and closes the robot then."""
    of_arm = {name: options[name] for name in OF_ARM if name in options and settings.robot == SIMULATED}
    robot = load_robot(settings.robot, {**of_arm, **settings.robot_options})
    connected: Robot | RobotEnv = DryRobot(robot) if settings.dry_run else robot
    try:
        safe = {"rate": settings.rate, "settle": settings.settle, "patience": settings.patience}
        rest = Rest(speed=settings.rest_speed, wait=settings.rest_wait)
        connected = RobotEnv(env, connected, rest=rest, log=settings.out, **safe)  # type: ignore[arg-type] # each is of its type
        if settings.record is None:
            return connected
        return RecordRollout(connected, settings.record, flush_period=None)  # writing meanwhile would take longer than a period
    except BaseException:
        connected.close()
        raise


def _tell_of_reach(env: gym.Env[Any, Any], seconds: float) -> None:
    """Say where the arm cannot hold its tip at the target of the episode that was begun; shapes of the arm it can."""
    episodes = episodes_of(env)
    target, model = episodes.target_at(0, np.linspace(0.0, seconds, LOOKS)), episodes.model
    (low, high), length = episodes.limits.T, 1e3 * model.length
    for position in np.unique(target.tip_pose[: 0 if target.q.size else LOOKS, :3, 3], axis=0):
        found = tension_for_tip_position(model, position, limits=(low, high), tolerance=NEAR * model.length)
        if not found.reachable:
            away = f"{1e3 * np.linalg.norm(position):.4g} mm from the base of an arm of {length:.4g} mm"
            text = f"tensions within their limits hold the tip no nearer than {1e3 * found.position_error:.3g} mm to it"
            print(f"note: the target is out of reach: it comes to be {away}, and {text}", file=sys.stderr)
            return


def _tell(report: Report, first: int) -> None:
    """Print errors from the `first` period on, and timing."""
    for name, values in report.errors.items():
        if values[first:].size:
            unit = error_unit(name)
            print(f"{unit.label}: {unit.text(root_mean_square(values[first:]))} (root mean square, as measured)")
    print(report.timing)
