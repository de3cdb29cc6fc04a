"""Page of the benchmark: its tables in Markdown."""

import math
from collections.abc import Callable, Mapping
from functools import partial

import numpy as np

from soft_tendon_env.arena.protocol import Condition
from soft_tendon_env.arena.standings import Standing, Standings
from soft_tendon_env.envs.tracking import error_unit
from soft_tendon_env.evaluation.conditions import BAD, DIFFICULTIES, NOMINAL, SETTINGS
from soft_tendon_env.evaluation.tables import Column, markdown_table, number, table_of
from soft_tendon_env.policies.regimes import REGIMES

PERCENT = 100.0


def tables(found: Standings) -> str:
    """The whole page."""
    parts = [_duel_table(found)]
    for regime in found.regimes():
        told = REGIMES[regime].description
        parts.append(f"### {regime}\n\n{told[0].upper()}{told[1:]}.")
        parts.append(_error_table(found, regime))
        parts += [_conduct_table(standings) for condition, standings in found.of.items() if condition[:2] == (regime, NOMINAL)][:1]
    return "\n\n".join(parts)


def legend() -> str:
    """Descriptions of settings and difficulties."""
    settings, difficulties = (
        [f"- `{name}`: {entry.description}." for name, entry in entries.items()] for entries in (SETTINGS, DIFFICULTIES)
    )
    return "\n".join([*settings, "", *difficulties])


def condition_title(condition: Condition, found: Standings) -> str:
    """Setting of a condition, or of the nominal one at another difficulty that."""
    return condition.setting if condition.difficulty == found.protocol.difficulty else condition.difficulty


def _error_table(found: Standings, regime: str) -> str:
    """Task's first error, by entrant and condition."""
    conditions = [condition for condition in found.of if condition.regime == regime]
    names = [entrant.label for entrant in found.protocol.entrants if any(entrant.label in found.of[condition] for condition in conditions)]
    columns: list[Column[str]] = [
        Column(condition_title(condition, found), partial(_cell, found, condition, best=found.best(condition))) for condition in conditions
    ]
    table = table_of(f"{error_unit(found.error).heading} RMS", {f"{name} ({found.kinds[name]})": name for name in names}, columns)
    said = f"`n % bad`: share of episodes that diverged, or were off by more than {PERCENT * BAD:g} % of the rod's length (RMS)."
    return f"{table}\n\nInterquartile mean (95 % interval); the best in bold; {said}"


def _cell(found: Standings, condition: Condition, name: str, best: str | None = None) -> str:
    standing, factor = found.of[condition][name], error_unit(found.error).factor
    mean, low, high = (number(factor * value) for value in standing.mean(found.key))
    text = f"{mean} ({low}-{high})"
    bad = f", {PERCENT * standing.bad:.0f} % bad" if standing.bad else ""
    return f"**{text}**{bad}" if name == best else f"{text}{bad}"


def _conduct_table(standings: Mapping[str, Standing]) -> str:
    """Numbers of how policies act under a condition of the nominal setting, by entrant."""

    def mean(heading: str, key: str, factor: float = 1.0) -> Column[Standing]:
        return Column(heading, lambda standing: number(factor * standing.mean(key).value))

    def margin(heading: str, of: Callable[[Standing], float]) -> Column[Standing]:
        return Column(heading, lambda standing: "inf" if math.isinf(of(standing)) else number(of(standing)))

    errors = next(iter(standings.values())).episodes[0].errors
    columns: list[Column[Standing]] = [
        *(
            mean(f"{error_unit(name).heading} {heading}", f"{name}_{kind}", error_unit(name).factor)
            for name in errors
            for kind, heading in (("rms", "RMS"), ("percentile_95", "p95"))
        ),
        Column("settled", lambda standing: f"{PERCENT * standing.settled:.0f} %"),
        mean("chatter [N]", "chatter"),
        mean("effort [N]", "effort"),
        margin("delay margin [ms]", lambda standing: 1e3 * standing.delay),
        margin("gain margin", lambda standing: standing.gain),
        Column("violations", lambda standing: str(standing.violations)),
        Column("time [ms]", lambda standing: number(1e3 * float(np.median(standing.values("seconds"))))),
    ]
    return table_of(NOMINAL, standings, columns)


def _duel_table(found: Standings) -> str:
    """Best learned against best model-based policy, by condition."""
    symbol = error_unit(found.error).symbol
    rows = [
        (
            condition.regime,
            condition_title(condition, found),
            f"{learned} {_cell(found, condition, learned)}",
            f"{model_based} {_cell(found, condition, model_based)}",
            f"{duel.probability:.2f} ({duel.low:.2f}-{duel.high:.2f})",
            (learned if duel.probability > 0.5 else model_based) if duel.separated else "-",
        )
        for condition, learned, model_based, duel in found.duels()
    ]
    header = ("regime", "setting", f"best learned, {symbol}", f"best model-based, {symbol}", "P(learned is better)", "separated")
    return markdown_table(header, rows) if rows else "Nobody plays against another kind of policy."
