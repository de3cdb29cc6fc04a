"""`soft-tendon arena`: learned and model-based policies on the same tasks, with the same information, on arms that no model matches."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from soft_tendon_env.cli.errors import require, writable_folder
from soft_tendon_env.cli.options import Parser
from soft_tendon_env.evaluation.benchmark import Benchmark, benchmark_tables, standings_by_regime
from soft_tendon_env.evaluation.conditions import SETTINGS
from soft_tendon_env.evaluation.experiment import Experiment
from soft_tendon_env.evaluation.pages import Page
from soft_tendon_env.evaluation.provenance import machine
from soft_tendon_env.evaluation.tables import records, write_csv
from soft_tendon_env.tools.configuration import read_toml
from soft_tendon_env.tools.files import configs_folder
from soft_tendon_env.tools.parallel import check_cluster

STOPPED = "stopped: the same command goes on"


class Arena(Benchmark):
    """Play a benchmark of policies, resuming where it was stopped, and write its tables, CSV and picture.

    Attributes:
        config: a TOML file with the keys of soft_tendon_env.evaluation.benchmark.Benchmark, or the name of one that ships; other options
            override it.
        policies: policies to compare in place of the file's entrants, by the names that evaluate takes.
        write_docs: a file in which tables also go between <!-- arena TASK --> and <!-- /arena TASK -->, with the picture beside it.
        out: folder for results.
    """

    config: str = "published"
    policies: tuple[str, ...] = ()
    write_docs: str | None = None
    out: str = "out/arena"


def run(arguments: Sequence[str]) -> None:
    """Play what is missing, print and write. Exit status 2 for mistakes."""
    parser = Parser("arena", Arena)
    settings = parser.read(arguments, read_benchmark)
    with parser.mistakes():
        require("pictures")
        out, marker = Path(settings.out), f"arena {settings.task}"
        page, (cells, notes) = Page(settings.write_docs, [marker]), settings.cells()
        experiment = Experiment(cells, out / "cells")
        check_cluster(settings.cluster)
        writable_folder(out)
    what = f"{settings.episodes} episodes of {settings.seconds:g} s"
    for note in notes:
        print(f"note: {note}")
    print(f"{len(experiment.cells)} cells, {len(experiment.missing())} of them to be played, {what} each; {machine()}", flush=True)
    experiment.play("arena", settings.workers, settings.cluster)
    from soft_tendon_env.evaluation.pictures import draw_errors

    found = standings_by_regime(settings, experiment)
    text, legend = benchmark_tables(settings, found), "\n".join(f"- `{name}`: {SETTINGS[name].description}." for name in settings.settings)
    print(f"\n{legend}\n\n{text}\n")
    write_csv(out / "arena.csv", [{"regime": regime, **row} for regime, of in found.items() for row in records(of)])
    panels = {f"information: {regime}": of for regime, of in found.items()}
    draw_errors(panels, out / "arena.png")
    if settings.write_docs is not None:
        picture = Path(settings.write_docs).with_suffix(".png")
        draw_errors(panels, picture)
        parts = [f"{what.capitalize()}.", *(f"Note: {note}." for note in notes), text]
        page.write(marker, "\n\n".join([*parts, f"![Errors of all policies by setting and regime]({picture.name})"]))


def read_benchmark(given: Mapping[str, Any]) -> dict[str, Any]:
    """Tables of the file of --config, checked, with the entrants of --policies in place of its own. Raises ConfigurationError."""
    path = Path(given.get("config", Arena.model_fields["config"].default))
    shipped = configs_folder() / f"{path}.toml"
    path = path if path.exists() or not shipped.exists() else shipped
    table = read_toml(path)
    if "policies" in given:
        table["entrants"] = [{"policy": policy} for policy in given["policies"]]
    Benchmark.parse(table, str(path))
    return table
