"""`soft-tendon arena`: learned and model-based policies on the same tasks, with the same
information, on arms that no model matches."""

from pathlib import Path
from typing import Any

from pydantic import Field, model_validator
from tyro.conf import Fixed, Suppress

from soft_tendon_env.cli.errors import mistakes, require, writable_folder
from soft_tendon_env.cli.options import PUBLISHED
from soft_tendon_env.evaluation.benchmark import (
    Benchmark,
    BenchmarkPolicy,
    benchmark_tables,
    standings_by_regime,
)
from soft_tendon_env.evaluation.experiment import Cell, Experiment
from soft_tendon_env.evaluation.provenance import machine
from soft_tendon_env.evaluation.tables import records, write_csv, write_markdown
from soft_tendon_env.policies.names import Agent, Controller, PolicyName
from soft_tendon_env.policies.regimes import REGIMES
from soft_tendon_env.tools.configuration import read_toml
from soft_tendon_env.tools.files import CONFIGS
from soft_tendon_env.tools.parallel import check_cluster

CONTROLLER_PACE = 0.2
"""Seconds of a core per second of an episode of the paper's arm under a controller, on an AMD
EPYC."""
AGENT_PACE = 0.05
"""Seconds of a core per second of an episode under an agent, likewise."""

CAPTION = (
    "*Errors by setting; further left is better. Lines: 95 % intervals."
    " Diamonds and squares: controllers. Circles: agents.*"
)
"""Sentences below the picture."""


class Arena(Benchmark):
    """Play a benchmark of policies, resuming where it was stopped, and write its tables, CSV and
    picture."""

    config: str = Field(
        default=PUBLISHED,
        description="TOML file of a Benchmark, or a name that ships; other options override it",
    )
    policies: tuple[str, ...] = Field(
        default=(),
        description="policies to compare in place of the file's, by their names for evaluate",
    )
    out: str = Field(default="out/arena", description="folder for results")

    # They have no option: those of --policies, or of the file.
    entrants: Suppress[Fixed[tuple[BenchmarkPolicy, ...]]] = Field(min_length=1)

    @model_validator(mode="before")
    @classmethod
    def _name_entrants(cls, values: dict[str, Any]) -> dict[str, Any]:
        """The entrants of --policies in place of the file's."""
        policies = values.get("policies")
        if not policies:
            return values
        chosen = (BenchmarkPolicy(policy=policy) for policy in policies)
        entrants = tuple(chosen)
        return {**values, "entrants": entrants}

    @classmethod
    def read_file(cls, config: str) -> "Arena":
        """The configuration of a file, or of one that ships. Raises ConfigurationError."""
        path = Path(config)
        shipped = CONFIGS / f"{path}.toml"
        if not path.exists() and shipped.exists():
            path = shipped
        table = read_toml(path)
        Benchmark.parse(table, str(path))
        return cls(**table)


def run(settings: Arena) -> None:
    """Play what is missing, print and write."""
    with mistakes():
        require("pictures")
        check_cluster(settings.cluster)
        out = Path(settings.out)
        cells, notes = settings.cells()
        experiment = Experiment(cells, out / "cells")
        writable_folder(out)
    episodes = f"{settings.episodes} episodes of {settings.seconds:g} s"
    for note in notes:
        print(f"note: {note}")
    missing = experiment.missing()
    core_hours = sum(_hours(experiment.cells[label]) for label in missing)
    hours = core_hours / settings.workers
    print(
        f"{len(experiment.cells)} cells, {len(missing)} of them to be played, {episodes}, about"
        f" {hours:.2g} hours; {machine()}",
        flush=True,
    )
    print(settings.actuators)
    experiment.play("arena", settings.workers, settings.cluster)
    from soft_tendon_env.evaluation.pictures import draw_errors

    standings = standings_by_regime(settings, experiment)
    text = benchmark_tables(settings, standings)
    print(f"\n{text}\n")

    rows = []
    panels = {}
    for regime, of_regime in standings.items():
        regime_rows = [{"regime": regime, **row} for row in records(of_regime)]
        rows += regime_rows
        panels[REGIMES[regime].title] = of_regime
    write_csv(out / "arena.csv", rows)
    draw_errors(panels, out / "arena.png")

    parts = [f"{episodes.capitalize()}. {settings.actuators}"]
    parts += [f"Note: {note}." for note in notes]
    parts += ["![Errors of all policies by setting and regime](arena.png)", CAPTION, text]
    write_markdown(out / "arena.md", "\n\n".join(parts))


def _hours(cell: Cell) -> float:
    """Time [h] that a cell is expected to take a core."""
    policy = PolicyName.parse(cell.policy, cell.task)
    if isinstance(policy, Controller) or (isinstance(policy, Agent) and policy.estimator):
        pace = CONTROLLER_PACE
    else:
        pace = AGENT_PACE
    simulated = len(cell.seeds) * cell.seconds
    return simulated * pace / 3600.0
