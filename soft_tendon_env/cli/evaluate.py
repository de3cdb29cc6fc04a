"""`soft-tendon evaluate`: one policy on the evaluation episodes, with the arm as the model says and
with one that differs from it."""

from pydantic import Field
from tyro.conf import Positional

from soft_tendon_env.cli.compare import play
from soft_tendon_env.cli.options import POLICY, TASK, EnvironmentArguments
from soft_tendon_env.evaluation.settings import Settings, TaskName


class Evaluate(EnvironmentArguments, Settings):
    """Print a row per model error, resuming where it was stopped, and write JSON with every
    episode, CSV, and a picture."""

    policy: Positional[str] = Field(description=POLICY)
    task: TaskName = Field(default="TipPose", description=TASK)
    out: str = Field(default="out/evaluate", description="folder for results")


def run(settings: Evaluate) -> None:
    """Evaluate, print and write."""
    play(settings, (settings.task,), (settings.policy,), settings.out)
