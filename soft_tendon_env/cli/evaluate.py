"""`soft-tendon evaluate`: one policy on the evaluation episodes, with the arm as the model says and with one that differs from it."""

from pydantic import Field

from soft_tendon_env.cli.compare import play
from soft_tendon_env.evaluation.settings import Settings, TableSettings, TaskName

POLICY = "a controller's name; an agent's folder or .zip file; ppo, sac, dagger or apg, which ship for the task; agent, the best of these"


class Evaluate(Settings, TableSettings):
    """Print a row per model error, resuming where it was stopped, and write JSON with every episode, CSV, and a picture."""

    policy: str = Field(description=POLICY)
    task: TaskName = Field(default="TipPose", description="name of the task: TipPose, Shape, Reach, or one that was registered")
    out: str = Field(default="out/evaluate", description="folder for results")


def run(settings: Evaluate) -> None:
    """Evaluate, print and write."""
    play(settings, (settings.task,), (settings.policy,), settings.out, settings.all)
