"""`soft-tendon compare`, `evaluate` and `record`: policies on the same episodes, on the arm of their model and on arms that differ."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from pydantic import Field

from soft_tendon_env.cli.errors import mistakes, require, writable_folder
from soft_tendon_env.evaluation import comparison, tables
from soft_tendon_env.evaluation.conditions import EVALUATION_SEEDS, NOMINAL
from soft_tendon_env.evaluation.entrants import agents_of, every_file, model_in_the_loop
from soft_tendon_env.evaluation.pages import Page
from soft_tendon_env.evaluation.provenance import machine, origin, write_json
from soft_tendon_env.evaluation.settings import Comparison, EpisodeSettings, Seeds, Settings, TaskName
from soft_tendon_env.evaluation.summaries import summarise
from soft_tendon_env.policies.names import PolicyName
from soft_tendon_env.recording import RerunFile
from soft_tendon_env.tools.configuration import read_toml
from soft_tendon_env.tools.parallel import check_cluster

CONFIG = "TOML file with the keys of Comparison, such as configs/compare.toml, which other options override"
TASK = "name of the task: TipPose, Shape, Reach, or one that was registered"
POLICY = "a controller's name; an agent's folder; ppo, sac, dagger or apg, which ship for the task; agent, the best of these"


class Compare(Comparison):
    """Print errors by policy and model error, resuming where it was stopped, and write JSON with every episode, CSV, and a picture."""

    config: str | None = Field(default=None, description=CONFIG)
    write_docs: str | None = Field(default=None, description="file in which tables go between <!-- compare TASK --> and its end")
    out: str = Field(default="out/compare", description="folder for results")

    @staticmethod
    def read_file(given: Mapping[str, Any]) -> dict[str, Any]:
        """Tables of the file of --config, checked; episodes or seeds on the command line override both. Raises ConfigurationError."""
        table = read_toml(given["config"]) if "config" in given else {}
        Comparison.parse(table, given.get("config", ""))
        episodes = {"episodes", "seeds"}
        return {key: value for key, value in table.items() if not (key in episodes and episodes & given.keys())}


class Evaluate(Settings):
    """Print a row per model error, resuming where it was stopped, and write JSON with every episode, CSV, and a picture."""

    policy: str = Field(description=POLICY)
    task: TaskName = Field(default="TipPose", description=TASK)
    out: str = Field(default="out/evaluate", description="folder for results")


class Record(EpisodeSettings):
    """Print the errors of policies, and write a file for the Rerun viewer in which each has an arm of its name."""

    policies: tuple[str, ...] = Field(min_length=1, description=POLICY)
    task: TaskName = Field(default="TipPose", description=TASK)
    seeds: Seeds = Field(default=EVALUATION_SEEDS[:1], min_length=1, description="seeds of the episodes, which are played in turn")
    out: str = Field(default="out/side_by_side.rrd", description="file of the recording")


def run_evaluate(settings: Evaluate) -> None:
    """Evaluate, print and write."""
    play(settings, (settings.task,), (settings.policy,), settings.out)


def run_compare(settings: Compare) -> None:
    """Compare, print and write, task by task."""
    with mistakes():
        markers = [f"compare {task}" for task in settings.tasks]
        page = Page(settings.write_docs, markers)
    for task, text in play(settings, settings.tasks, settings.policies, settings.out).items():
        page.write(f"compare {task}", text)


def play(settings: Settings, tasks: Sequence[str], policies: tuple[str, ...], out: str) -> dict[str, str]:
    """Play policies under every model error, print and write results; returns tables by task. Raises Mistake."""
    folder = Path(out)
    with mistakes():
        require("pictures")
        files = {task: agents_of(task, policies) for task in tasks}
        arms = {task: comparison.shared_arms(settings, task, every_file(of_task)) for task, of_task in files.items()}
        experiments = {task: comparison.compare(settings, task, of_task, folder / "cells") for task, of_task in arms.items()}
        check_cluster(settings.cluster)
        writable_folder(folder)
        comparison.print_caveats(settings, arms)
    from soft_tendon_env.evaluation.pictures import draw_errors

    what, texts = f"{len(settings.seeds)} episodes of {settings.seconds:g} s", dict[str, str]()
    print(f"{what}; {machine()}")
    for task, experiment in experiments.items():
        experiment.play(f"{task}: policies x model errors", settings.workers, settings.cluster)
        found, summaries = comparison.standings_of(experiment, files[task])
        shown = comparison.comparison_tables(task, files[task], found, summaries)
        print(f"\n## {task}\n\n{shown}\n")
        texts[task] = f"{what.capitalize()}.\n\n{shown}"
        write_json(folder / f"{task}.json", {**origin(), **comparison.results_record(settings, task, arms[task], found, summaries)})
        tables.write_csv(folder / f"{task}.csv", tables.records(found))
        draw_errors({task: found}, folder / f"{task}.png")
    return texts


def run_record(settings: Record) -> None:
    """Record and print."""
    task, out = settings.task, Path(settings.out)
    with mistakes():
        require("recording")
        arms = comparison.shared_arms(settings, task, every_file(agents_of(task, settings.policies)))
        cells = {name: comparison.make_cell(settings, settings.seeds, task, name, own, NOMINAL) for name, own in arms.items()}
        players = {name: comparison.alone(cell).open() for name, cell in cells.items()}
        comparison.print_caveats(settings, {task: arms})
        file = RerunFile(out)
    print(f"{task}, episodes of {settings.seconds:g} s from seeds {', '.join(map(str, settings.seeds))}; {machine()}\n")
    with file:
        scores = comparison.record_side_by_side(players, file, settings.seeds, settings.skip)
    summaries = {policy: summarise(of_policy) for policy, of_policy in scores.items()}
    models = {policy: model_in_the_loop(PolicyName.parse(policy, task)) for policy in summaries}
    print(f"{tables.summary_table('policy', summaries, models)}\n\n{comparison.opening_hint(out)}")
