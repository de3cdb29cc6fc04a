"""`soft-tendon evaluate`: one policy on the evaluation episodes, with the arm as the model says and with one that differs from it."""

import re
from collections.abc import Sequence
from pathlib import Path

from soft_tendon_env.cli.errors import require, writable_folder
from soft_tendon_env.cli.options import Parser
from soft_tendon_env.evaluation import summarise
from soft_tendon_env.evaluation.provenance import configuration_record, machine, result_record, write_json
from soft_tendon_env.evaluation.settings import Settings, TaskName, make_env, make_run, print_caveats, scores_of
from soft_tendon_env.evaluation.tables import full_table
from soft_tendon_env.policies.load import load_policy, short_name

STOPPED = "stopped: nothing is written before the end"


class Evaluate(Settings):
    """Print a row per model error, and write every episode as JSON, a picture, and the configuration as resolved.

    Attributes:
        policy: a controller's name, or measured:NAME; an agent's folder or .zip file (ALGORITHM:file.zip, if the file does not say);
            "agent", the one that ships for the task.
        task: of the environment: TipPose, Shape, Reach, or one that was registered.
        out: folder for results.
    """

    policy: str
    task: TaskName = "TipPose"
    out: str = "out/evaluate"


def run(arguments: Sequence[str]) -> None:
    """Evaluate, print and write."""
    parser = Parser("evaluate", Evaluate)
    settings = parser.read(arguments)
    policy, out = settings.policy, Path(settings.out)
    with parser.mistakes():
        require("pictures")
        runs = [make_run(settings, settings.seeds, settings.task, policy, error) for error in settings.errors]
        load_policy(policy, make_env(runs[0]))  # what is wrong is said before anything takes long
        writable_folder(out)
        print_caveats(settings, runs)
    from soft_tendon_env.evaluation.pictures import draw_episodes

    print(f"{policy} on {settings.task}, {len(settings.seeds)} episodes of {settings.seconds:g} s; {machine()}\n")
    scores = {run.error: scores_of(run, progress=True) for run in runs}
    summaries = {error: summarise(of_error) for error, of_error in scores.items()}
    print(full_table("model error", summaries), "\n")
    stem = out / f"{settings.task}_{re.sub(r'[^A-Za-z0-9]+', '_', policy.removesuffix('.zip')).strip('_')}"
    results = [result_record(policy, error, summaries[error], scores[error]) for error in scores]
    write_json(stem.with_suffix(".json"), {"task": settings.task, "results": results})
    write_json(stem.with_suffix(".configuration.json"), configuration_record(settings, runs))
    draw_episodes(scores, f"{short_name(policy)} on {settings.task}", stem.with_suffix(".png"))
