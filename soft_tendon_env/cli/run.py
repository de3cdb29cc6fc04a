"""`soft-tendon run`: a policy on a robot, real or simulated, with a log of it."""

from contextlib import ExitStack
from pathlib import Path
from typing import Any

import gymnasium as gym
from pydantic import Field
from tyro.conf import Positional

from soft_tendon_env.cli.errors import mistakes, require
from soft_tendon_env.cli.options import EnvironmentArguments
from soft_tendon_env.cli.robot_settings import RobotSettings
from soft_tendon_env.envs import IDS
from soft_tendon_env.envs.episodes import episodes_of
from soft_tendon_env.envs.tracking import error_unit
from soft_tendon_env.evaluation.metrics import root_mean_square
from soft_tendon_env.evaluation.provenance import machine
from soft_tendon_env.evaluation.settings import EpisodeSettings, Seed, TaskName, episode_steps
from soft_tendon_env.policies.names import PolicyName
from soft_tendon_env.policies.protocol import Policy
from soft_tendon_env.recording import RecordRollout
from soft_tendon_env.robots.environment import (
    rehearse,
    run_policy,
)
from soft_tendon_env.robots.log import check_log
from soft_tendon_env.robots.simulated import OF_ARM
from soft_tendon_env.tools.messages import UserError

POLICY = (
    "a controller's name behind filtered:; an agent's folder, or agent, ppo, sac, dagger, apg,"
    " alone or behind filtered:; module:name"
)


class Run(RobotSettings, EnvironmentArguments, EpisodeSettings):
    """Run a policy on a robot in real time, print its errors as measured and the jitter of the
    loop, and write a log."""

    policy: Positional[str] = Field(description=POLICY)
    task: TaskName = Field(
        default="TipPose",
        description="name of the task: TipPose, Reach, or one that was registered",
    )
    seed: Seed = Field(default=0, description="of the target")
    beyond_training: bool = Field(
        default=False, description="let an agent act on an arm that is none of its training"
    )
    record: str | None = Field(
        default=None,
        description="file for the Rerun viewer: the measured tip over the simulated arm",
    )
    out: str = Field(default="out/run.csv", description="log, a new .csv file")


def run(settings: Run) -> None:
    """Run, print and write. Raises UserError where the robot was stopped before the end."""
    out = Path(settings.out)
    task = settings.task
    with mistakes(), ExitStack() as on_error:
        check_log(out)
        if settings.record:
            require("recording")
        steps = episode_steps(settings.seconds, settings.skip, settings.options)
        name = PolicyName.parse(settings.policy, task)
        options = name.options(settings.options)
        env = gym.make(IDS[task], max_episode_steps=steps, **options)
        policy = load_trained(name, env, settings.beyond_training)
        rehearse(policy, env, settings.seed)

        of_arm = {key: options[key] for key in OF_ARM if key in options}
        real: gym.Env[Any, Any] = settings.opened(env, settings.out, of_arm)
        on_error.callback(real.close)
        if settings.record:
            # Writing meanwhile would take longer than a period.
            real = RecordRollout(real, settings.record, flush_period=None)
        on_error.pop_all()
    print(f"{settings.policy} on {settings.robot}, {settings.seconds:g} s; {machine()}\n")
    try:
        report = run_policy(policy, real, settings.seconds, settings.seed)
    finally:  # also after Ctrl-C
        if out.exists():
            print(f"written: {out}")
        stop = real.get_wrapper_attr("stopped")
        if stop:
            tendons = "slack"
            if not stop.slack:
                tendons = f"not slack, the robot does not answer: {stop.failures[-1]}"
            milliseconds = 1e3 * stop.seconds
            print(f"{stop.cause}: tendons {tendons} after {milliseconds:.0f} ms\n")

    periods = settings.skip / episodes_of(real).period
    skipped_periods = round(periods)
    for error, values in report.errors.items():
        counted = values[skipped_periods:]
        if counted.size:
            unit = error_unit(error)
            text = unit.text(root_mean_square(counted))
            print(f"{unit.label}: {text} (root mean square, as measured)")
    print(report.timing)
    if not report.finished:
        raise UserError(f"the robot was stopped: {report.stop.cause}")


def load_trained(name: PolicyName, env: Any, beyond_training: bool) -> Policy:
    """The policy of a name, for an arm of its training unless it may act on any.

    Raises ValueError, OSError.
    """
    if beyond_training:
        return name.load_beyond_training(env)
    outside = name.outside(env)
    if outside:
        raise ValueError(
            f"{name.text} was not trained for this arm: {outside}. Train an agent for it, or let"
            " this one act all the same with --beyond-training"
        )
    return name.load(env)
