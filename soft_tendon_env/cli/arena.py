"""`soft-tendon arena`: learned and model-based policies on the same tasks, with the same information, on arms that nobody was told of."""

from collections.abc import Sequence
from pathlib import Path

from soft_tendon_env.arena.page import csv_records, legend, played, tables
from soft_tendon_env.arena.play import missing_cells, play_all, read_result
from soft_tendon_env.arena.protocol import Protocol, cells
from soft_tendon_env.cli.errors import require, writable_folder
from soft_tendon_env.cli.options import Parser, add_options, configure
from soft_tendon_env.evaluation.provenance import machine, origin, write_json
from soft_tendon_env.evaluation.tables import around_markers, write_between_markers, write_csv
from soft_tendon_env.tools.configuration import Configuration, read_toml
from soft_tendon_env.tools.files import shipped_folder

STOPPED = "stopped: the same command goes on"


class Arena(Configuration):
    """Play a benchmark of policies, resuming where it was stopped, and write its tables, CSV, picture and recordings.

    Attributes:
        config: a TOML file with the keys of soft_tendon_env.arena.protocol.Protocol; by default the one that ships, arena.toml.
        policies: entrants in place of the file's, by what `policy` of an entrant says.
        settings, regimes, difficulties, episodes, seconds, workers: go before what the file says.
        no_margins: leave delay and gain margins out.
        record: write a Rerun file too for every condition where a learned and a model-based policy meet.
        only_tables: play nothing, show what has been played.
        write_docs: a file in which tables also go between <!-- arena TASK --> and <!-- /arena TASK -->.
        out: folder for results.
    """

    config: str = "arena"
    policies: tuple[str, ...] = ()
    settings: tuple[str, ...] = ()
    regimes: tuple[str, ...] = ()
    difficulties: tuple[str, ...] = ()
    episodes: int | None = None
    seconds: float | None = None
    workers: int | None = None
    no_margins: bool = False
    record: bool = False
    only_tables: bool = False
    write_docs: str | None = None
    out: str = "out/arena"


OVERRIDES = ("settings", "regimes", "difficulties", "episodes", "seconds", "workers")


def run(arguments: Sequence[str]) -> None:
    """Play what is missing, print and write. Exit status 2 for mistakes."""
    parser = Parser("arena", Arena)
    add_options(parser, Arena)
    given = vars(parser.parse_args(arguments))
    with parser.mistakes():
        settings = configure(Arena, given)
        protocol = read_protocol(settings)
        require("pictures", *(("recording",) if settings.record else ()))
        kinds = {entrant.label: entrant.kind(protocol.task) for entrant in protocol.entrants}
        every = list(cells(protocol))
        docs, out = None if settings.write_docs is None else Path(settings.write_docs), Path(settings.out)
        if docs is not None:
            around_markers(docs, marker(protocol.task))
        folder = writable_folder(writable_folder(out) / "cells")
        left = missing_cells(every, folder)
        if settings.only_tables:
            every = [cell for cell in every if cell not in left]
            if not every:
                raise ValueError(f"nothing has been played in {out}: leave --only-tables out")
    if not settings.only_tables:
        each = f"{protocol.episodes} episodes of {protocol.seconds:g} s each"
        print(f"{len(every)} cells, {len(left)} of them to be played, {each}; {machine()}")
        play_all(left, folder, protocol.workers)
    found = played(protocol, kinds, every, [read_result(cell, folder) for cell in every])
    text = tables(found)
    print(f"\n{legend()}\n\n{text}\n")
    write_json(out / "arena.json", {**origin(), "protocol": protocol.model_dump(mode="json"), "commits": found.commits})
    write_csv(out / "arena.csv", csv_records(found))
    from soft_tendon_env.arena.pictures import draw_arena

    draw_arena(found, out / "arena.png")
    if settings.record:
        from soft_tendon_env.arena.recordings import record_duels

        for path in record_duels(found, every, out / "recordings"):
            print(f"written: {path}")
    if docs is not None:
        what = f"{protocol.episodes} episodes of {protocol.seconds:g} s, on {machine()}"
        write_between_markers(docs, marker(protocol.task), f"Written by `soft-tendon arena --write-docs FILE`: {what}.\n\n{text}")


def read_protocol(settings: Arena) -> Protocol:
    """The protocol of a file, with what the command line says in its place. Raises ConfigurationError, ValueError, OSError."""
    path = Path(settings.config)
    shipped = shipped_folder("learning/configs", "configs") / f"{settings.config}.toml"
    source = path if path.exists() or not shipped.exists() else shipped
    table = read_toml(source)
    table |= {name: value for name in OVERRIDES if (value := getattr(settings, name)) not in ((), None)}
    if settings.policies:
        table["entrants"] = [{"policy": policy} for policy in settings.policies]
    if settings.no_margins:
        table["margins"] = False
    return Protocol.parse(table, str(source))


def marker(task: str) -> str:
    return f"arena {task}"
