"""`soft-tendon train`: one training of Stable-Baselines3, as a configuration says."""

from collections.abc import Sequence
from pathlib import Path

from pydantic import Field

from soft_tendon_env.cli.errors import require, writable_folder
from soft_tendon_env.cli.options import Parser
from soft_tendon_env.evaluation.records import machine
from soft_tendon_env.learning.config import config_names, find_config, read_training
from soft_tendon_env.tools.configuration import Configuration

STOPPED = "stopped: the same command with --resume goes on from the last checkpoint, if there is one"


class Train(Configuration):
    """Train an agent with Stable-Baselines3; the folder's best/ is a policy for every other command.

    Attributes:
        config: the name of a training that ships (listed below), or the path of a TOML file.
        seed: of networks, arms and exploration; the configuration's by default.
        set: goes before the configuration, dotted keys with values as in TOML, such as steps=20_000 options.fidelity=fast.
        out: folder of the run (default: out/runs/CONFIG/seed_SEED).
        resume: go on from the last checkpoint in the folder, if there is one.
    """

    config: str
    seed: int | None = Field(default=None, ge=0)
    set: tuple[str, ...] = ()
    out: str | None = None
    resume: bool = False


def run(arguments: Sequence[str]) -> None:
    """Train."""
    parser = Parser("train", Train)
    parser.epilog = f"Trainings that ship: {', '.join(config_names())}."
    settings = parser.read(Train, arguments, ("config",))
    with parser.mistakes():
        require("agents")
        from soft_tendon_env.learning import train
        from soft_tendon_env.learning.training_env import check_stages

        path = find_config(settings.config)
        seed = {} if settings.seed is None else {"seed": settings.seed}
        training = train.add_controller_options(read_training(path, settings.set, **seed))
        folder = Path("out", "runs", path.stem, f"seed_{training.seed}") if settings.out is None else Path(settings.out)
        checkpoint = train.checkpoint_to_resume(folder, training, settings.resume)
        check_stages(training)
        model = train.model_of(training, checkpoint)
        learning = train.learning_of(training, writable_folder(folder), checkpoint)
    print(f"{training.algorithm} on {training.task}, {training.steps} steps, seed {training.seed}, into {folder}; {machine()}")
    if settings.resume and checkpoint is None:
        print(f"nothing to resume: {folder} has no checkpoint, the training begins at step 0")
    train.learn(model, learning)
