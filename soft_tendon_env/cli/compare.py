"""`soft-tendon compare`: controllers and agents on the same episodes, on the arm of their model and on arms that differ."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from soft_tendon_env.cli.errors import require, writable_folder
from soft_tendon_env.cli.options import Parser
from soft_tendon_env.evaluation.compare import compare, make_runs, tables_of, write_task
from soft_tendon_env.evaluation.provenance import configuration_record, machine, write_json
from soft_tendon_env.evaluation.settings import Comparison, print_caveats
from soft_tendon_env.evaluation.sweeps import Results, agents_of
from soft_tendon_env.evaluation.tables import around_markers, write_between_markers
from soft_tendon_env.tools.configuration import read_toml

STOPPED = "stopped: the tasks that were through are written"


class Compare(Comparison):
    """Print errors by policy and model error, and write JSON with every episode, CSV, a picture, and the configuration as resolved.

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
        files = {task: agents_of(task, settings.policies) for task in settings.tasks}
        runs = {task: make_runs(settings, task, files[task], settings.errors, settings.seeds) for task in settings.tasks}
        docs, out = None if settings.write_docs is None else Path(settings.write_docs), Path(settings.out)
        for task in settings.tasks:
            if docs is not None:
                around_markers(docs, marker(task))
        writable_folder(out)
        print_caveats(settings, [run for of_task in runs.values() for run in of_task])
    print(f"{len(settings.seeds)} episodes of {settings.seconds:g} s; {machine()}")
    write_json(out / "configuration.json", configuration_record(settings, [run for of_task in runs.values() for run in of_task]))
    for task in settings.tasks:
        results = Results(files[task], *compare(runs[task], settings.workers))
        tables = tables_of(results.all_summaries())
        print(f"\n## {task}\n\n{tables}\n")
        write_task(out, task, results, settings.episode_csv)
        if docs is not None:
            what = f"{len(settings.seeds)} episodes of {settings.seconds:g} s, on {machine()}"
            write_between_markers(docs, marker(task), f"Written by `soft-tendon compare --write-docs FILE`: {what}.\n\n{tables}")


EPISODES = {"episodes", "seeds"}
"""Keys that say which episodes there are: one of them on the command line overrides both in a file."""


def read_comparison(given: Mapping[str, Any]) -> dict[str, Any]:
    """Tables of the file of --config, checked, but for keys that other options override. Raises ConfigurationError."""
    if "config" not in given:
        return {}
    table = read_toml(given["config"])
    Comparison.parse(table, given["config"])
    return {key: value for key, value in table.items() if not (key in EPISODES and EPISODES & given.keys())}


def marker(task: str) -> str:
    return f"compare {task}"
