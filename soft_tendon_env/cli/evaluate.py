"""`soft-tendon evaluate`: one policy on the evaluation episodes, with the arm as the model says and with one that differs from it."""

import re
from collections.abc import Mapping, Sequence
from pathlib import Path

from pydantic import Field

from soft_tendon_env.cli.errors import require, writable_folder
from soft_tendon_env.cli.options import Parser
from soft_tendon_env.evaluation.comparison import (
    TIME,
    compare,
    models_of,
    print_caveats,
    results_record,
    shared_arms,
    standings_of,
    summaries_of,
)
from soft_tendon_env.evaluation.provenance import machine, origin, write_json
from soft_tendon_env.evaluation.settings import Settings, TableSettings, TaskName
from soft_tendon_env.evaluation.tables import summary_table
from soft_tendon_env.tools.parallel import check_cluster

STOPPED = "stopped: the same command goes on"


class Evaluate(Settings, TableSettings):
    """Print a row per model error, resuming where it was stopped, and write every episode as JSON, and a picture.

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
    policy, task, out = settings.policy, settings.task, Path(settings.out)
    with parser.mistakes():
        require("pictures")
        arms = shared_arms(settings, task, [policy])
        experiment = compare(settings, task, arms, out / "cells")
        check_cluster(settings.cluster)
        writable_folder(out)
        print_caveats(settings, {task: arms})
    from soft_tendon_env.evaluation.pictures import draw_errors

    print(f"{policy} on {task}, {len(settings.seeds)} episodes of {settings.seconds:g} s; {machine()}\n")
    experiment.play(f"{policy}: model errors", settings.workers, settings.cluster)
    files: Mapping[str, Mapping[int | None, str]] = {policy: {None: policy}}
    found = standings_of(experiment, files)
    summaries = {error: summary for (_, error), summary in summaries_of(found).items()}
    print(summary_table("model error", summaries, settings.all, dict.fromkeys(summaries, models_of(task, files)[policy])), "\n")
    stem = out / f"{task}_{re.sub(r'[^A-Za-z0-9]+', '_', policy.removesuffix('.zip')).strip('_')}"
    write_json(stem.with_suffix(".json"), {**origin(), **results_record(settings, task, arms, found)})
    draw_errors({task: {key: found[key] for key in found if key[1] != TIME}}, stem.with_suffix(".png"))
