"""`soft-tendon compare`: controllers and agents on the same episodes, on the arm of their model and
on arms that differ."""

from collections.abc import Sequence
from pathlib import Path

from pydantic import Field

from soft_tendon_env.cli.errors import mistakes, require, writable_folder
from soft_tendon_env.cli.options import TASK, EnvironmentArguments
from soft_tendon_env.envs import IDS
from soft_tendon_env.evaluation import comparison, tables
from soft_tendon_env.evaluation.entrants import agents_of
from soft_tendon_env.evaluation.provenance import machine, origin, write_json
from soft_tendon_env.evaluation.settings import Settings, TaskName
from soft_tendon_env.policies.names import ALL
from soft_tendon_env.tools.parallel import check_cluster

POLICIES = (
    'names of controllers, "all" of them, agent, ppo, sac, dagger or apg (which ship), folders of'
    " agents, any of these behind filtered:, or folders of runs"
)


class Compare(EnvironmentArguments, Settings):
    """Print errors by policy and model error, resuming where it was stopped, and write JSON with
    every episode, CSV, and a picture."""

    task: tuple[TaskName, ...] = Field(
        default_factory=lambda: tuple(IDS),
        min_length=1,
        description=TASK,
    )
    policies: tuple[str, ...] = Field(default=(ALL,), min_length=1, description=POLICIES)
    out: str = Field(default="out/compare", description="folder for results")


def run(settings: Compare) -> None:
    """Compare, print and write, task by task."""
    play(settings, settings.task, settings.policies, settings.out)


def play(settings: Settings, tasks: Sequence[str], policies: tuple[str, ...], out: str) -> None:
    """Play policies under every model error, print and write results. Raises Mistake."""
    folder = Path(out)
    with mistakes():
        require("pictures")
        # before arms are made, which may take a trial of each
        check_cluster(settings.cluster)
        files = {task: agents_of(task, policies) for task in tasks}
        arms = {}
        experiments = {}
        for task in tasks:
            arms[task] = comparison.shared_arms(settings, task, files[task])
            cells = folder / "cells"
            experiments[task] = comparison.compare(settings, task, arms[task], cells)
        writable_folder(folder)
    from soft_tendon_env.evaluation.pictures import draw_errors

    episodes = f"{settings.episodes} episodes of {settings.seconds:g} s"
    print(f"{episodes}; {machine()}")
    for task, experiment in experiments.items():
        experiment.play(task, settings.workers, settings.cluster)
        standings, summaries = comparison.standings_of(experiment, files[task])
        errors = tables.error_table(standings)
        print(f"\n## {task}\n")
        if len(files[task]) > 1:
            print(f"{errors}\n\n{tables.ERRORS_LEGEND}\n")
        table = comparison.numbers_table(task, files[task], summaries)
        print(f"{table}\n")

        results = comparison.results_record(settings, task, arms[task], standings, summaries)
        write_json(folder / f"{task}.json", {**origin(), **results})
        records = tables.records(standings)
        tables.write_csv(folder / f"{task}.csv", records)
        text = f"{episodes.capitalize()}.\n\n{errors}"
        tables.write_markdown(folder / f"{task}.md", text)
        draw_errors({task: standings}, folder / f"{task}.png")
