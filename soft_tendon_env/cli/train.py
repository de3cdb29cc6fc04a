"""`soft-tendon train`: one training of Stable-Baselines3 or of RLlib, as a configuration says."""

from contextlib import ExitStack
from pathlib import Path
from typing import Any, ClassVar, Literal

from pydantic import Field
from tyro.conf import Positional

from soft_tendon_env.cli.errors import mistakes, require, writable_folder
from soft_tendon_env.evaluation.provenance import machine
from soft_tendon_env.learning.config import Training, config_names, find_config, read_training
from soft_tendon_env.tools.configuration import Configuration
from soft_tendon_env.tools.parallel import ray_cluster

ENGINE = (
    "Stable-Baselines3 in one process, or RLlib with environments in processes of their own (PPO"
    " alone)"
)

RUNNERS = 2
"""Processes with environments of a training of RLlib, by default."""


class Train(Configuration):
    """Train an agent with Stable-Baselines3 or RLlib; the folder's best/ is a policy for every
    other command."""

    STOPPED: ClassVar[str] = (
        "stopped: the same command with --resume goes on from the last checkpoint, if there is one"
    )
    config: Positional[str] = Field(
        description=(
            f"a training that ships ({', '.join(config_names())}), or the path of a TOML file"
        )
    )
    seed: int | None = Field(
        default=None,
        ge=0,
        description="seed of networks, arms and exploration; by default the configuration's",
    )
    set: tuple[str, ...] = Field(
        default=(), description="overrides of the file, such as steps=20_000 options.fidelity=fast"
    )
    out: str | None = Field(
        default=None, description="folder of the run (default: out/runs/CONFIG/seed_SEED)"
    )
    resume: bool = Field(
        default=False, description="go on from the last checkpoint in the folder, if there is one"
    )
    engine: Literal["sb3", "rllib"] = Field(default="sb3", description=ENGINE)
    runners: int | None = Field(
        default=None,
        ge=0,
        le=10_000,
        description=(
            f"RLlib's processes with environments, by default {RUNNERS}; 0: the process that learns"
            " has all"
        ),
    )
    cluster: str | None = Field(
        default=None,
        description='address of a Ray cluster for RLlib, or "auto"; by default one of its own',
    )


def run(settings: Train) -> None:
    """Train, and say what is done."""
    with ExitStack() as stack:
        with mistakes():
            if settings.engine == "sb3":
                of_rllib = {"--cluster": settings.cluster, "--runners": settings.runners}
                lines = []
                for option, value in of_rllib.items():
                    if value is not None:
                        lines.append(f"{option} is for --engine rllib")
                if lines:
                    raise ValueError("\n".join(lines))
            require("agents" if settings.engine == "sb3" else "rllib")
            from soft_tendon_env.learning.monitor import TrainingCallback
            from soft_tendon_env.learning.train import checkpoint_to_resume, learn, model_of

            path = find_config(settings.config)
            changes = {}
            if settings.seed is not None:
                changes["seed"] = settings.seed
            training = read_training(path, settings.set, **changes)
            folder = Path("out", "runs", path.stem, f"seed_{training.seed}")
            if settings.out is not None:
                folder = Path(settings.out)
            checkpoint = checkpoint_to_resume(folder, training, settings.resume, settings.engine)
            if settings.engine == "sb3":
                model = model_of(training, checkpoint)
                callback = TrainingCallback(training, writable_folder(folder), checkpoint)
            else:
                learning = rllib_training(settings, training, folder, checkpoint, stack)
        print(
            f"{training.algorithm} on {training.task}, {training.steps} steps, seed"
            f" {training.seed}, into {folder}; {machine()}"
        )
        if settings.resume and checkpoint is None:
            print(f"nothing to resume: {folder} has no checkpoint, the training begins at step 0")
        if settings.engine == "sb3":
            learn(model, callback)
        else:
            learning.learn()


def rllib_training(
    settings: Train, training: Training, folder: Path, checkpoint: Path | None, stack: ExitStack
) -> Any:
    """A training of RLlib on a cluster, or on a Ray of its own, which ends with the stack. Raises
    ValueError, OSError."""
    from soft_tendon_env.learning.rllib import RllibTraining, make_config

    if settings.runners is None:
        runners = RUNNERS
    else:
        runners = settings.runners
    make_config(training, runners)
    stack.enter_context(ray_cluster(settings.cluster, runners, f"{runners} runners"))
    return RllibTraining(training, writable_folder(folder), runners, checkpoint)
