"""`soft-tendon compare`: controllers and agents on the same episodes, on the arm of their model and on arms that differ."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from soft_tendon_env.cli.errors import require, writable_folder
from soft_tendon_env.cli.options import Parser
from soft_tendon_env.evaluation.comparison import (
    TIME,
    compare,
    comparison_tables,
    models_of,
    print_caveats,
    results_record,
    shared_arms,
    standings_of,
)
from soft_tendon_env.evaluation.entrants import agents_of, every_file
from soft_tendon_env.evaluation.pages import Page
from soft_tendon_env.evaluation.provenance import machine, origin, write_json
from soft_tendon_env.evaluation.settings import Comparison, TableSettings
from soft_tendon_env.evaluation.tables import records, write_csv
from soft_tendon_env.tools.configuration import read_toml
from soft_tendon_env.tools.parallel import check_cluster

STOPPED = "stopped: the same command goes on"


class Compare(Comparison, TableSettings):
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
        require("pictures")
        out = Path(settings.out)
        files = {task: agents_of(task, settings.policies) for task in settings.tasks}
        arms = {task: shared_arms(settings, task, every_file(of_task)) for task, of_task in files.items()}
        experiments = {task: compare(settings, task, of_task, out / "cells") for task, of_task in arms.items()}
        page = Page(settings.write_docs, [f"compare {task}" for task in settings.tasks])
        check_cluster(settings.cluster)
        writable_folder(out)
        print_caveats(settings, arms)

    from soft_tendon_env.evaluation.pictures import draw_errors

    what = f"{len(settings.seeds)} episodes of {settings.seconds:g} s"
    print(f"{what}; {machine()}")
    for task, experiment in experiments.items():
        experiment.play(f"{task}: policies x model errors", settings.workers, settings.cluster)
        found = standings_of(experiment, files[task])
        tables = comparison_tables(found, models_of(task, files[task]), settings.all)
        print(f"\n## {task}\n\n{tables}\n")
        write_json(out / f"{task}.json", {**origin(), **results_record(settings, task, arms[task], found)})
        write_csv(out / f"{task}.csv", records(found))
        draw_errors({task: {key: found[key] for key in found if key[1] != TIME}}, out / f"{task}.png")
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
