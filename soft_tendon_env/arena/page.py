"""The page of the benchmark: its tables in Markdown, and all its numbers as CSV records."""

import math
from collections.abc import Iterator, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from soft_tendon_env.arena.entrants import Kind
from soft_tendon_env.arena.protocol import Cell, Protocol
from soft_tendon_env.arena.standings import Comparison, Condition, Standing, compared, standings
from soft_tendon_env.envs.error_units import error_unit
from soft_tendon_env.evaluation.conditions import BAD, DIFFICULTIES, NOMINAL, REGIMES, SETTINGS
from soft_tendon_env.evaluation.tables import markdown_table, number

LEARNED: tuple[Kind, ...] = ("learned", "hybrid", "other")
PERCENT = 100.0


class Played(NamedTuple):
    """All results of a protocol, by condition and entrant; margins [s], [-] by regime and entrant; `kinds` of the entrants."""

    protocol: Protocol
    kinds: Mapping[str, Kind]
    standings: Mapping[Condition, Mapping[str, Standing]]
    margins: Mapping[str, Mapping[str, tuple[float, float]]]
    commits: tuple[str, ...]

    @property
    def error(self) -> str:
        """The task's first error."""
        record = next(iter(next(iter(self.standings.values())).values())).records[0][0]
        return next(key.removesuffix("_rms") for key in record if key.endswith("_rms"))

    def regimes(self) -> list[str]:
        """Those that anybody played in."""
        return [regime for regime in self.protocol.regimes if any(condition[0] == regime for condition in self.standings)]


def played(protocol: Protocol, kinds: Mapping[str, Kind], cells: Sequence[Cell], results: Sequence[Mapping[str, Any]]) -> Played:
    """Put results together. Delay and gain margins are the smallest of all poses and members."""
    margins: dict[str, dict[str, tuple[float, float]]] = {}
    for cell, result in zip(cells, results, strict=True):
        if cell.kind == "margins":
            of_regime = margins.setdefault(cell.regime, {})
            before = of_regime.get(cell.entrant, (math.inf, math.inf))
            own = [(_number(found["delay"]), _number(found["gain"])) for found in result["margins"]]
            delay, gain = np.min([before, *own], axis=0).tolist()
            of_regime[cell.entrant] = delay, gain
    commits = tuple(dict.fromkeys(str(result["commit"]) for result in results))
    return Played(protocol, kinds, standings(cells, results), margins, commits)


def _number(value: float | None) -> float:
    """JSON has no infinity."""
    return math.inf if value is None else value


def duels(found: Played) -> Iterator[tuple[Condition, str, str, Comparison]]:
    """Under every condition where both kinds play: the best policy that has learned, the best that is model-based, and how they compare."""
    for condition, of in found.standings.items():
        best = [_best(of, [name for name in of if (found.kinds[name] in LEARNED) == learned], found.error) for learned in (True, False)]
        if best[0] is not None and best[1] is not None:
            yield condition, best[0], best[1], compared(of[best[0]], of[best[1]], f"{found.error}_rms")


def _best(of: Mapping[str, Standing], names: Sequence[str], error: str) -> str | None:
    return min(names, key=lambda name: of[name].mean(f"{error}_rms").value, default=None)


def tables(found: Played) -> str:
    """The whole page, in Markdown."""
    parts = [_duel_table(found)]
    for regime in found.regimes():
        told = REGIMES[regime].description
        parts.append(f"### {regime}\n\n{told[0].upper()}{told[1:]}.")
        parts.append(_error_table(found, regime))
        parts += [_conduct_table(found, condition) for condition in found.standings if condition[:2] == (regime, NOMINAL)][:1]
    return "\n\n".join(parts)


def condition_title(condition: Condition, found: Played) -> str:
    """A setting, or of the nominal one at another difficulty that."""
    _, setting, difficulty = condition
    return setting if difficulty == found.protocol.difficulty else difficulty


def _error_table(found: Played, regime: str) -> str:
    """The task's first error, by entrant and condition."""
    unit = error_unit(found.error)
    conditions = [condition for condition in found.standings if condition[0] == regime]
    names = [entrant.label for entrant in found.protocol.entrants if any(entrant.label in found.standings[c] for c in conditions)]
    best = {condition: _best(found.standings[condition], list(found.standings[condition]), found.error) for condition in conditions}
    rows = []
    for name in names:
        cells = [_cell(found.standings[c][name], f"{found.error}_rms", unit.factor, best[c] == name) for c in conditions]
        rows.append((f"{name} ({found.kinds[name]})", *cells))
    table = markdown_table((f"{unit.heading} RMS", *(condition_title(condition, found) for condition in conditions)), rows)
    said = f"`n % bad`: share of episodes that diverged, or were off by more than {PERCENT * BAD:g} % of the rod's length (RMS)."
    return f"{table}\n\nInterquartile mean (95 % interval); the best in bold; {said}"


def _cell(standing: Standing, key: str, factor: float, best: bool) -> str:
    mean, low, high = standing.mean(key)
    text = f"{number(factor * mean)} ({number(factor * low)}-{number(factor * high)})"
    bad = f", {PERCENT * standing.bad:.0f} % bad" if standing.bad else ""
    return f"**{text}**{bad}" if best else f"{text}{bad}"


def _conduct_table(found: Played, condition: Condition) -> str:
    """How policies act under a condition of the nominal setting, by entrant."""
    rows, regime = [], condition[0]
    for name, standing in found.standings[condition].items():
        delay, gain = found.margins.get(regime, {}).get(name, (math.nan, math.nan))
        rows.append(
            (
                name,
                *(_mean(standing, f"{error}_{kind}", error_unit(error).factor) for error, kind in _errors(standing)),
                f"{PERCENT * standing.settled:.0f} %",
                _mean(standing, "chatter", 1.0),
                _mean(standing, "effort", 1.0),
                "inf" if math.isinf(delay) else number(1e3 * delay),
                "inf" if math.isinf(gain) else number(gain),
                str(standing.violations),
                number(1e3 * float(np.median(standing.values("seconds")))),
            )
        )
    first = next(iter(found.standings[condition].values()))
    errors = [f"{error_unit(error).heading} {'RMS' if kind == 'rms' else 'p95'}" for error, kind in _errors(first)]
    header = ("nominal", *errors, "settled", "chatter [N]", "effort [N]", "delay margin [ms]", "gain margin", "violations", "time [ms]")
    return markdown_table(header, rows)


def _errors(standing: Standing) -> list[tuple[str, str]]:
    """Errors and what of them there is."""
    kinds = ("rms", "percentile_95")
    return [(key.removesuffix(f"_{kind}"), kind) for key in standing.records[0][0] for kind in kinds if key.endswith(f"_{kind}")]


def _mean(standing: Standing, key: str, factor: float) -> str:
    return number(factor * standing.mean(key).value)


def _duel_table(found: Played) -> str:
    """Where learned and model-based policies stand against each other."""
    unit = error_unit(found.error)
    rows = []
    for condition, learned, model_based, comparison in duels(found):
        of = found.standings[condition]
        winner = learned if comparison.probability > 0.5 else model_based
        rows.append(
            (
                condition[0],
                condition_title(condition, found),
                f"{learned} {_cell(of[learned], f'{found.error}_rms', unit.factor, False)}",
                f"{model_based} {_cell(of[model_based], f'{found.error}_rms', unit.factor, False)}",
                f"{comparison.probability:.2f} ({comparison.low:.2f}-{comparison.high:.2f})",
                f"{winner}" if comparison.separated else "-",
            )
        )
    header = ("regime", "setting", f"best learned, {unit.symbol}", f"best model-based, {unit.symbol}", "P(learned is better)", "separated")
    return markdown_table(header, rows) if rows else "Nobody plays against another kind of policy."


def legend() -> str:
    """What settings and difficulties are, in Markdown."""
    lines = [f"- `{name}`: {setting.description}." for name, setting in SETTINGS.items()]
    return "\n".join([*lines, "", *(f"- `{name}`: {difficulty.description}." for name, difficulty in DIFFICULTIES.items())])


def csv_records(found: Played) -> list[dict[str, Any]]:
    """Every number of every entrant under every condition, SI units, with the bounds of its interval; None where it is not finite."""
    records = []
    for (regime, setting, difficulty), of in found.standings.items():
        for name, standing in of.items():
            delay, gain = found.margins.get(regime, {}).get(name, (math.nan, math.nan))
            record: dict[str, Any] = {"regime": regime, "setting": setting, "difficulty": difficulty, "entrant": name}
            record |= {"kind": found.kinds[name], "members": len(standing.records), "episodes": len(standing.records[0])}
            for key in [*(f"{error}_{kind}" for error, kind in _errors(standing)), "chatter", "effort", "seconds"]:
                mean = standing.mean(key)
                record |= {key: mean.value, f"{key}_low": mean.low, f"{key}_high": mean.high}
            record |= {"settled": standing.settled, "bad": standing.bad, "violations": standing.violations}
            record |= {"delay_margin": delay, "gain_margin": gain}
            records.append({key: None if isinstance(value, float) and not math.isfinite(value) else value for key, value in record.items()})
    return records
