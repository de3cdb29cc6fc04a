"""`soft-tendon arena`: learned and model-based policies on the same tasks, with the same information, on arms that no model matches."""

import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from pydantic import Field

from soft_tendon_env.arena import page as pages
from soft_tendon_env.arena.protocol import Protocol
from soft_tendon_env.arena.standings import csv_records, standings_of
from soft_tendon_env.cli.errors import mistakes, require, writable_folder
from soft_tendon_env.evaluation.conditions import PLANT
from soft_tendon_env.evaluation.experiment import Experiment
from soft_tendon_env.evaluation.pages import Page, agent_sources, sources_of
from soft_tendon_env.evaluation.provenance import machine, origin, write_json
from soft_tendon_env.evaluation.tables import write_csv
from soft_tendon_env.policies.trained_by import shipped_notes
from soft_tendon_env.tools.configuration import read_toml
from soft_tendon_env.tools.files import configs_folder
from soft_tendon_env.tools.parallel import check_cluster


class Arena(Protocol):
    """Play a benchmark of policies, resuming where it was stopped, and write its tables, CSV and picture. Estimates its time first."""

    config: str = Field(default="published", description="TOML file of a Protocol, or a name that ships; other options override it")
    policies: tuple[str, ...] = Field(default=(), description="policies to compare in place of the file's, by their names for evaluate")
    only_tables: bool = Field(default=False, description="play nothing, show what has been played")
    only_estimate: bool = Field(default=False, description="play nothing, print the estimate of the time that it takes")
    write_docs: str | None = Field(default=None, description="file in which tables go between <!-- arena TASK --> and its end")
    out: str = Field(default="out/arena", description="folder for results")


def read_file(given: Mapping[str, Any]) -> dict[str, Any]:
    """Tables of the file of --config, checked, with the entrants of --policies in place of its own. Raises ConfigurationError."""
    path = Path(given.get("config", "published"))
    shipped = configs_folder() / f"{path}.toml"
    path = path if path.exists() or not shipped.exists() else shipped
    table = {**read_toml(path), **({"entrants": [{"policy": policy} for policy in given["policies"]]} if "policies" in given else {})}
    Protocol.parse(table, str(path))
    return table


def run(settings: Arena) -> None:
    """Play what is missing, print and write."""
    with mistakes():
        require("pictures")
        out, marker = Path(settings.out), f"arena {settings.task}"
        settings, notes = settings.present()
        plays = [entrant.plays for entrant in settings.entrants]
        page = Page(settings.write_docs, [marker], PLANT, [*sources_of([settings.config]), *agent_sources(plays)])
        experiment = Experiment(settings.cells(), out / "cells")
        check_cluster(settings.cluster)
        writable_folder(out)
        left = experiment.missing()
        experiment = experiment.played() if settings.only_tables else experiment
        if not experiment.cells:
            raise ValueError(f"nothing has been played in {out}: leave --only-tables out")
    what = f"{settings.episodes} episodes of {settings.seconds:g} s"
    print(*(f"note: {note}" for note in (*notes, *shipped_notes(plays, settings.task))), sep="\n")
    if not settings.only_tables:
        seconds = experiment.estimate(settings.workers, settings.cluster, lambda label: label._replace(seed=None))
        print(f"{len(experiment.cells)} cells, {len(left)} of them to be played, {what} each; {machine()}")
        time = f"{seconds / 60.0:.0f} min" if seconds > 120.0 else f"{math.ceil(seconds)} s"
        print(f"estimated time: {time}, {settings.workers} side by side", flush=True)
        if settings.only_estimate:
            return
        experiment.play("arena", settings.workers, settings.cluster)
    found = standings_of(settings, experiment)
    text, picture = pages.tables(found), out / "arena.png" if settings.write_docs is None else Path(settings.write_docs).with_suffix(".png")
    print(f"\n{pages.legend()}\n\n{text}\n")
    protocol = settings.model_dump(mode="json", include={*Protocol.model_fields})
    write_json(out / "arena.json", {**origin(), "protocol": protocol, "commits": found.commits, "notes": notes})
    write_csv(out / "arena.csv", csv_records(found))
    from soft_tendon_env.arena.pictures import draw_arena

    draw_arena(found, picture)
    parts = [f"{what.capitalize()}.", *(f"Note: {note}." for note in notes), text]
    page.write(marker, "\n\n".join([*parts, f"![Errors of all entrants by setting and regime]({picture.name})"]))
