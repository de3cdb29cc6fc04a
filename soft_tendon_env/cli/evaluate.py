"""`soft-tendon evaluate`: one policy on the evaluation episodes, with the arm as the model says and with one that differs from it."""

import re
from collections.abc import Sequence

from pydantic import Field

from soft_tendon_env.cli.compare import play
from soft_tendon_env.cli.options import Parser
from soft_tendon_env.evaluation.pages import Page
from soft_tendon_env.evaluation.settings import Settings, TaskName

STOPPED = "stopped: the same command goes on"


class Evaluate(Settings):
    """Print a row per model error, resuming where it was stopped, and write JSON with every episode, CSV, and a picture.

    Attributes:
        policy: a controller's name, or filtered:NAME; an agent's folder or .zip file;
            ppo, sac, dagger or apg, of those that ship for the task; agent, the best of these.
        task: name of the task: TipPose, Shape, Reach, or one that was registered.
        out: folder for results.
    """

    policy: str
    task: TaskName = "TipPose"
    workers: int = Field(default=1, ge=1)
    out: str = "out/evaluate"


def run(arguments: Sequence[str]) -> None:
    """Evaluate, print and write."""
    parser = Parser("evaluate", Evaluate)
    settings = parser.read(arguments)
    stem = re.sub(r"[^A-Za-z0-9]+", "_", settings.policy.removesuffix(".zip")).strip("_")
    play(parser, settings, {settings.task: f"{settings.task}_{stem}"}, (settings.policy,), settings.out, Page(None, []))
