"""`soft-tendon arena`: learned and model-based policies on the same tasks, with the same information, on arms that no model matches."""

import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from soft_tendon_env import recording
from soft_tendon_env.arena.page import legend, tables
from soft_tendon_env.arena.protocol import Label, Protocol
from soft_tendon_env.arena.standings import Standings, csv_records, standings_of
from soft_tendon_env.cli.errors import require, writable_folder
from soft_tendon_env.cli.options import Parser
from soft_tendon_env.evaluation.comparison import alone, record_side_by_side
from soft_tendon_env.evaluation.conditions import PLANT
from soft_tendon_env.evaluation.experiment import Experiment
from soft_tendon_env.evaluation.pages import Page, agent_sources, sources_of
from soft_tendon_env.evaluation.provenance import machine, origin, write_json
from soft_tendon_env.evaluation.tables import write_csv
from soft_tendon_env.policies.trained_by import shipped_notes
from soft_tendon_env.tools.configuration import read_toml
from soft_tendon_env.tools.files import configs_folder
from soft_tendon_env.tools.parallel import check_cluster

STOPPED = "stopped: the same command goes on"


class Arena(Protocol):
    """Play a benchmark of policies, resuming where it was stopped, and write its tables, CSV, picture and recordings. Prints an estimate of
    its time first.

    Attributes:
        config: a TOML file with the keys of soft_tendon_env.arena.protocol.Protocol, or the name of one that ships; other options
            override it.
        policies: policies to compare in place of the file's entrants, by the names that evaluate takes.
        record: write a Rerun file too for every condition where a learned and a model-based policy meet.
        only_tables: play nothing, show what has been played.
        only_estimate: play nothing, print the estimate of the time that it takes.
        write_docs: a file in which tables also go between <!-- arena TASK --> and <!-- /arena TASK -->, with the picture beside it.
        out: folder for results.
    """

    config: str = "published"
    policies: tuple[str, ...] = ()
    record: bool = False
    only_tables: bool = False
    only_estimate: bool = False
    write_docs: str | None = None
    out: str = "out/arena"


def run(arguments: Sequence[str]) -> None:
    """Play what is missing, print and write. Exit status 2 for mistakes."""
    parser = Parser("arena", Arena)
    settings = parser.read(arguments, read_protocol)
    with parser.mistakes():
        require("pictures", *(("recording",) if settings.record else ()))
        out, marker = Path(settings.out), f"arena {settings.task}"
        settings, notes = settings.present()
        sources = [*sources_of([settings.config]), *agent_sources(entrant.plays for entrant in settings.entrants)]
        page = Page(settings.write_docs, [marker], PLANT, sources)
        experiment = Experiment(settings.cells(), out / "cells")
        check_cluster(settings.cluster)
        writable_folder(out)
        left = experiment.missing()
        if settings.only_tables:
            experiment = experiment.played()
            if not experiment.cells:
                raise ValueError(f"nothing has been played in {out}: leave --only-tables out")
    what = f"{settings.episodes} episodes of {settings.seconds:g} s"
    for note in (*notes, *shipped_notes((entrant.plays for entrant in settings.entrants), settings.task)):
        print(f"note: {note}")
    if not settings.only_tables:
        print(f"{len(experiment.cells)} cells, {len(left)} of them to be played, {what} each; {machine()}", flush=True)
        seconds = experiment.estimate(settings.workers, settings.cluster, lambda label: label._replace(seed=None))
        print(f"estimated time: {_duration(seconds)}, {settings.workers} side by side", flush=True)
        if settings.only_estimate:
            return
        experiment.play("arena", settings.workers, settings.cluster)
    found = standings_of(settings, experiment)
    text = tables(found)
    print(f"\n{legend()}\n\n{text}\n")
    protocol = settings.model_dump(mode="json", include={*Protocol.model_fields})
    write_json(out / "arena.json", {**origin(), "protocol": protocol, "commits": found.commits, "notes": notes})
    write_csv(out / "arena.csv", csv_records(found))
    from soft_tendon_env.arena.pictures import draw_arena

    draw_arena(found, out / "arena.png")
    if settings.record:
        for path in record_duels(found, experiment, out / "recordings"):
            print(f"written: {path}")
    if settings.write_docs is not None:
        picture = Path(settings.write_docs).with_suffix(".png")
        draw_arena(found, picture)
        parts = [f"{what.capitalize()}.", *(f"Note: {note}." for note in notes), text]
        page.write(marker, "\n\n".join([*parts, f"![Errors of all entrants by setting and regime]({picture.name})"]))


def _duration(seconds: float) -> str:
    """A time in words, "2 h 5 min" or "40 s"."""
    minutes = round(seconds / 60.0)
    return f"{minutes // 60} h {minutes % 60} min" if minutes >= 60 else f"{minutes} min" if minutes else f"{math.ceil(seconds)} s"


def read_protocol(given: Mapping[str, Any]) -> dict[str, Any]:
    """Tables of the file of --config, checked, with the entrants of --policies in place of its own. Raises ConfigurationError."""
    path = Path(given.get("config", Arena.model_fields["config"].default))
    shipped = configs_folder() / f"{path}.toml"
    path = path if path.exists() or not shipped.exists() else shipped
    table = read_toml(path)
    if "policies" in given:
        table["entrants"] = [{"policy": policy} for policy in given["policies"]]
    Protocol.parse(table, str(path))
    return table


def record_duels(found: Standings, experiment: Experiment[Label], folder: Path) -> list[Path]:
    """Write a file REGIME_SETTING_DIFFICULTY.rrd for every condition in which the best learned and the best model-based policy meet, of the
    first episode of both side by side. Raises OSError."""
    first = {(label.entrant, label.condition): alone(cell) for label, cell in experiment.cells.items()}
    written = []
    for condition, *names, _ in found.duels():
        written.append(folder / f"{'_'.join(condition)}.rrd")
        cells = [first[name, condition] for name in names]
        with recording.RerunFile(written[-1]) as file:
            arms = [name.replace(":", " ") for name in names]
            record_side_by_side([cell.open() for cell in cells], file, arms, cells[0].seeds, cells[0].skip)
    return written
