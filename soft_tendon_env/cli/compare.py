"""`soft-tendon compare`: controllers and agents on the same episodes, on the arm of their model and on arms that differ."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from soft_tendon_env.cli.errors import require, writable_folder
from soft_tendon_env.cli.options import Parser
from soft_tendon_env.evaluation import comparison
from soft_tendon_env.evaluation.entrants import agents_of, every_file
from soft_tendon_env.evaluation.pages import Page
from soft_tendon_env.evaluation.provenance import machine, origin, write_json
from soft_tendon_env.evaluation.settings import Comparison, Settings
from soft_tendon_env.evaluation.tables import records, write_csv
from soft_tendon_env.tools.configuration import read_toml
from soft_tendon_env.tools.parallel import check_cluster

STOPPED = "stopped: the same command goes on"


class Compare(Comparison):
    """Print errors by policy and model error, resuming where it was stopped, and write JSON with every episode, CSV, and a picture.

    Attributes:
        config: a TOML file with the keys of Comparison, such as configs/compare.toml; options on the command line override it.
        write_docs: a file in which tables also go between <!-- compare TASK --> and <!-- /compare TASK -->.
        out: folder for results.
    """

    config: str | None = None
    write_docs: str | None = None
    out: str = "out/compare"


def run(arguments: Sequence[str]) -> None:
    """Compare, print and write, task by task."""
    parser = Parser("compare", Compare)
    settings = parser.read(arguments, read_comparison)
    with parser.mistakes():
        page = Page(settings.write_docs, [f"compare {task}" for task in settings.tasks])
    play(parser, settings, {task: task for task in settings.tasks}, settings.policies, settings.out, page)


def play(parser: Parser[Any], settings: Settings, stems: Mapping[str, str], policies: Sequence[str], out: str, page: Page) -> None:
    """Play policies under every model error, print tables by task, and write them, JSON, CSV and a picture into files of these stems."""
    folder = Path(out)
    with parser.mistakes():
        require("pictures")
        files = {task: agents_of(task, policies) for task in stems}
        arms = {task: comparison.shared_arms(settings, task, every_file(of_task)) for task, of_task in files.items()}
        experiments = {task: comparison.compare(settings, task, of_task, folder / "cells") for task, of_task in arms.items()}
        check_cluster(settings.cluster)
        writable_folder(folder)
        comparison.print_caveats(settings, arms)
    from soft_tendon_env.evaluation.pictures import draw_errors

    what = f"{len(settings.seeds)} episodes of {settings.seconds:g} s"
    print(f"{what}; {machine()}")
    for task, experiment in experiments.items():
        experiment.play(f"{task}: policies x model errors", settings.workers, settings.cluster)
        found, summaries = comparison.standings_of(experiment, files[task])
        tables = comparison.comparison_tables(task, files[task], found, summaries)
        print(f"\n## {task}\n\n{tables}\n")
        stem = folder / stems[task]
        write_json(stem.with_suffix(".json"), {**origin(), **comparison.results_record(settings, task, arms[task], found, summaries)})
        write_csv(stem.with_suffix(".csv"), records(found))
        draw_errors({task: found}, stem.with_suffix(".png"))
        page.write(f"compare {task}", f"{what.capitalize()}.\n\n{tables}")


EPISODES = {"episodes", "seeds"}
"""Keys that say which episodes there are: one of them on the command line overrides both in a file."""


def read_comparison(given: Mapping[str, Any]) -> dict[str, Any]:
    """Tables of the file of --config, checked, but for keys that other options override. Raises ConfigurationError."""
    if "config" not in given:
        return {}
    table = read_toml(given["config"])
    Comparison.parse(table, given["config"])
    return {key: value for key, value in table.items() if not (key in EPISODES and EPISODES & given.keys())}
