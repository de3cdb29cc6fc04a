"""Page of the benchmark: its tables in Markdown."""

from collections.abc import Mapping
from functools import partial

import numpy as np

from soft_tendon_env.arena.protocol import Condition
from soft_tendon_env.arena.standings import Standing, Standings
from soft_tendon_env.envs.tracking import error_unit
from soft_tendon_env.evaluation.conditions import DIFFICULTIES, NOMINAL, SETTINGS
from soft_tendon_env.evaluation.entrants import model_in_the_loop, randomised_in_training
from soft_tendon_env.evaluation.summaries import HIGH
from soft_tendon_env.evaluation.tables import MODEL, TAILS, Column, markdown_table, number, table_of
from soft_tendon_env.policies.names import Agent
from soft_tendon_env.policies.regimes import REGIMES
from soft_tendon_env.policies.trained_by import trained_by

PERCENT = 100.0


def tables(found: Standings) -> str:
    """The whole page."""
    parts = [_duel_table(found), _entrant_table(found)]
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
    columns: list[Column[str]] = []
    for condition in conditions:
        title, steady = condition_title(condition, found), f"{found.error}_steady_state"
        columns.append(Column(title, partial(_cell, found, condition, best=found.best(condition))))
        if any(np.isfinite(standing.values(steady)).any() for standing in found.of[condition].values()):
            columns.append(Column(f"{title}, steady state", partial(_cell, found, condition, key=steady)))
    table = table_of(f"{error_unit(found.error).heading} RMS", {f"{name} ({found.kinds[name]})": name for name in names}, columns)
    return f"{table}\n\nInterquartile mean (95 % interval) / mean / p{HIGH} / share bad; the best interquartile mean in bold. {TAILS}."


def _cell(found: Standings, condition: Condition, name: str, best: str | None = None, key: str = "") -> str:
    """A number of an entrant, that by which entrants are ranked where `key` names none."""
    if name not in found.of[condition]:
        return "-"
    standing, factor, key = found.of[condition][name], error_unit(found.error).factor, key or found.key
    value, low, high, mean, tail = (number(factor * value) for value in (*standing.mean(key), *standing.tails(key)))
    text = f"**{value} ({low}-{high})**" if name == best else f"{value} ({low}-{high})"
    return f"{text} / {mean} / {tail} / {PERCENT * standing.bad:.0f} %"


def _conduct_table(standings: Mapping[str, Standing]) -> str:
    """Numbers of how policies act under a condition of the nominal setting, by entrant."""

    def mean(heading: str, key: str, factor: float = 1.0) -> Column[Standing]:
        numbers = lambda standing: (standing.mean(key).value, *standing.tails(key))  # noqa: E731
        return Column(heading, lambda standing: " / ".join(number(factor * value) for value in numbers(standing)))

    errors = next(iter(standings.values())).episodes[0].errors
    columns: list[Column[Standing]] = [
        *(mean(f"{error_unit(name).heading} RMS", f"{name}_rms", error_unit(name).factor) for name in errors),
        Column("bad", lambda standing: f"{PERCENT * standing.bad:.0f} %"),
        Column("settled", lambda standing: f"{PERCENT * standing.settled:.0f} %"),
        mean("chatter [N]", "chatter"),
        mean("effort [N]", "effort"),
        Column("violations", lambda standing: str(standing.violations)),
        Column("time [ms]", lambda standing: number(1e3 * float(np.median(standing.values("seconds"))))),
    ]
    return f"{table_of(NOMINAL, standings, columns)}\n\nInterquartile mean / mean / p{HIGH}."


def _duel_table(found: Standings) -> str:
    """Best learned beside best model-based policy, by condition, and how often it is ahead."""
    unit, duels = error_unit(found.error), [*found.duels()]
    if not duels:
        return "Nobody plays against another kind of policy."
    rows = [
        (
            condition.regime,
            condition_title(condition, found),
            f"{learned} {_cell(found, condition, learned)}",
            f"{model_based} {_cell(found, condition, model_based)}",
            "{} ({} to {})".format(*(number(unit.factor * value) for value in duel.difference)),
            "{:.2f} ({:.2f}-{:.2f})".format(*duel.probability),
            duel.verdict,
        )
        for condition, learned, model_based, duel in duels
    ]
    header = ("regime", "setting", "best learned", "best controller", f"gap [{unit.symbol}]", "P(learned is better)", "learned is")
    counts = (
        f"{regime}: " + ", ".join(f"{verdicts.count(word)} {word}" for word in ("ahead", "behind", "not separated"))
        for regime in found.regimes()
        if (verdicts := [duel.verdict for condition, *_, duel in duels if condition.regime == regime])
    )
    legend = (
        f"Errors: {unit.heading} RMS, interquartile mean with its 95 % interval / mean / p{HIGH} / share bad. "
        "Gap: the error of the best learned policy less that of the best controller on the same episodes, with the interval of the "
        "difference. Where the interval leaves out zero, the learned policy is `ahead` or `behind`. Both are chosen by these episodes, "
        "which flatters both."
    )
    return f"Learned policies by regime: {'; '.join(counts)}.\n\n{markdown_table(header, rows)}\n\n{legend}"


def _entrant_table(found: Standings) -> str:
    """Entrants: what they are, and what they know."""
    rows, task = [], found.protocol.task
    for entrant in found.protocol.entrants:
        standings = [standings[entrant.label] for standings in found.of.values() if entrant.label in standings]
        if not standings:
            continue
        members = entrant.members(task)
        first = next(iter(members.values()))
        regimes = [regime for regime in found.regimes() if any(entrant.label in found.of[c] for c in found.of if c.regime == regime)]
        seeds = "-" if None in members else str(len(members))
        model = model_in_the_loop(first, entrant.told)
        training = (trained_by(first.text, task), randomised_in_training(first)) if isinstance(first, Agent) else ("-", "-")
        episodes = str(len(standings[0].episodes))
        rows.append((entrant.label, found.kinds[entrant.label], entrant.plays, ", ".join(regimes), model, *training, seeds, episodes))
    header = ("method", "kind", "policy", "regimes", MODEL, "training", "domain randomisation and effects in training", "seeds", "episodes")
    return markdown_table(header, rows)
