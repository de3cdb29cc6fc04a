"""`soft-tendon train`: one training of Stable-Baselines3 or of RLlib, as a configuration says."""

from collections.abc import Sequence
from contextlib import ExitStack
from pathlib import Path
from typing import Literal

from pydantic import Field, model_validator

from soft_tendon_env.cli.errors import require, writable_folder
from soft_tendon_env.cli.options import Parser
from soft_tendon_env.evaluation.provenance import machine
from soft_tendon_env.learning.config import Training, config_names, find_config, read_training
from soft_tendon_env.tools.configuration import Configuration, ConfigurationError, Problem
from soft_tendon_env.tools.parallel import ray_cluster

RUNNERS = 2
"""Processes with environments of RLlib, by default."""

STOPPED = "stopped: the same command with --resume goes on from the last checkpoint, if there is one"


class Train(Configuration):
    """Train an agent with Stable-Baselines3 or RLlib; the folder's best/ is a policy for every other command.

    Attributes:
        config: the name of a training that ships (listed below), or the path of a TOML file.
        seed: seed of networks, arms and exploration; by default the configuration's.
        set: overrides the configuration, dotted keys with values as in TOML, such as steps=20_000 options.fidelity=fast.
        out: folder of the run (default: out/runs/CONFIG/seed_SEED).
        resume: go on from the last checkpoint in the folder, if there is one.
        engine: "sb3", Stable-Baselines3 in one process, or "rllib", RLlib with environments in processes of their own (PPO alone, see
            docs/how_to/train_at_scale.md).
        runners: number of RLlib's processes with environments, each with an equal part of the arms; 0: the process that learns has all
            (default: 2).
        cluster: address of a Ray cluster for RLlib, or "auto" for the one of this machine; by default it starts one of its own here.
    """

    config: str
    seed: int | None = Field(default=None, ge=0)
    set: tuple[str, ...] = ()
    out: str | None = None
    resume: bool = False
    engine: Literal["sb3", "rllib"] = "sb3"
    runners: int | None = Field(default=None, ge=0, le=10_000)
    cluster: str | None = None

    @model_validator(mode="after")
    def _fits_the_engine(self) -> "Train":
        for key in ("runners", "cluster"):
            if getattr(self, key) is not None and self.engine != "rllib":
                raise ConfigurationError([Problem((key,), "is for --engine rllib")])
        return self


def run(arguments: Sequence[str]) -> None:
    """Train, and say what is done."""
    parser = Parser("train", Train)
    parser.epilog = f"Trainings that ship: {', '.join(config_names())}."
    settings = parser.read(arguments)
    with parser.mistakes():
        require("agents" if settings.engine == "sb3" else "rllib")
        from soft_tendon_env.learning import train
        from soft_tendon_env.learning.monitor import TrainingCallback

        path = find_config(settings.config)
        seed = {} if settings.seed is None else {"seed": settings.seed}
        training = read_training(path, settings.set, **seed)
        folder = Path("out", "runs", path.stem, f"seed_{training.seed}") if settings.out is None else Path(settings.out)
        checkpoint = train.checkpoint_to_resume(folder, training, settings.resume, settings.engine)
    if settings.engine == "rllib":
        train_with_rllib(parser, settings, training, folder, checkpoint)
        return
    with parser.mistakes():
        model = train.model_of(training, checkpoint)
        callback = TrainingCallback(training, writable_folder(folder), checkpoint)
    announce(settings, training, folder, checkpoint)
    train.learn(model, callback)


def train_with_rllib(parser: Parser[Train], settings: Train, training: Training, folder: Path, checkpoint: Path | None) -> None:
    """Trains on a cluster, or on a Ray of its own, which ends with it."""
    from soft_tendon_env.learning.rllib import RllibTraining, make_config

    runners = RUNNERS if settings.runners is None else settings.runners
    with ExitStack() as stack:
        with parser.mistakes():
            make_config(training, runners)
            writable_folder(folder)
            stack.enter_context(ray_cluster(settings.cluster, runners, f"{runners} runners"))
            learning = RllibTraining(training, folder, runners, checkpoint)
        announce(settings, training, folder, checkpoint)
        learning.learn()


def announce(settings: Train, training: Training, folder: Path, checkpoint: Path | None) -> None:
    print(f"{training.algorithm} on {training.task}, {training.steps} steps, seed {training.seed}, into {folder}; {machine()}")
    if settings.resume and checkpoint is None:
        print(f"nothing to resume: {folder} has no checkpoint, the training begins at step 0")
