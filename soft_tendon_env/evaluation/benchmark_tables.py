"""Page of the benchmark: its tables in Markdown, and its picture."""

from pathlib import Path

from soft_tendon_env.envs.options import Options, resolved_scene
from soft_tendon_env.envs.tracking import error_unit
from soft_tendon_env.evaluation.benchmark import Place, Standings
from soft_tendon_env.evaluation.entrants import model_in_the_loop
from soft_tendon_env.evaluation.summaries import HIGH, Tails
from soft_tendon_env.evaluation.tables import MODEL, TAILS, markdown_table, number
from soft_tendon_env.policies.names import Agent
from soft_tendon_env.policies.regimes import REGIMES
from soft_tendon_env.tools.configuration import plain


def benchmark_tables(found: Standings) -> str:
    """The whole page."""
    parts = [_duel_table(found), _policy_table(found)]
    for regime in found.regimes:
        parts += [f"### {regime}\n\n{REGIMES[regime].description.capitalize()}.", _error_table(found, regime)]
    return "\n\n".join(parts)


def draw_benchmark(found: Standings, path: Path) -> None:
    """Draw interquartile means with their intervals, a panel per regime. Raises OSError."""
    from soft_tendon_env.evaluation.pictures import draw_errors

    unit, panels = error_unit(found.error), dict[str, dict[str, dict[str, tuple[float, float, float]]]]()
    for place, standings in found.of.items():
        panel = panels.setdefault(f"information: {place.regime}", {})
        for name, standing in standings.items():
            value, low, high = standing.mean(f"{found.error}_rms")
            panel.setdefault(name, {})[place.setting] = (unit.factor * value, unit.factor * low, unit.factor * high)
    draw_errors(panels, f"{unit.heading} RMS", path)


def _cell(found: Standings, place: Place, name: str, kind: str = "rms") -> str:
    """An error of a policy at a place."""
    if name not in found.of[place]:
        return "-"
    standing, factor, key = found.of[place][name], error_unit(found.error).factor, f"{found.error}_{kind}"
    value, low, high, mean, tail = (number(factor * value) for value in (*standing.mean(key), *Tails.of(standing.values(key))))
    return f"{value} ({low}-{high}) / {mean} / {tail} / {100.0 * standing.bad:.0f} %"


def _error_table(found: Standings, regime: str) -> str:
    """Task's first error, by policy and setting."""
    places = [place for place in found.of if place.regime == regime]
    names = [entrant.label for entrant in found.benchmark.entrants if any(entrant.label in found.of[place] for place in places)]
    best = {(place, found.best(place, learned)) for place in places for learned in (True, False)}
    rows = []
    for name in names:
        cells = [f"**{text}**" if (place, name) in best else text for place in places for text in (_cell(found, place, name),)]
        rows.append((f"{name} ({'model-based' if name in found.controllers else 'learned'})", *cells))
    legend = f"Interquartile mean (95 % interval) / mean / p{HIGH} / share bad; the best of either kind in bold. {TAILS}."
    header = (f"{error_unit(found.error).heading} RMS", *(place.setting for place in places))
    return f"{markdown_table(header, rows)}\n\n{legend}"


def _duel_table(found: Standings) -> str:
    """Best learned beside best model-based policy, by place, and how often it is ahead."""
    unit, duels = error_unit(found.error), [*found.duels()]
    if not duels:
        return "Nobody plays against another kind of policy."
    rows, verdicts = [], list[str]()
    for place, learned, other, duel in duels:
        gap = "{} ({} to {})".format(*(number(unit.factor * value) for value in duel.difference))
        both = (f"{name} {_cell(found, place, name)}" for name in (learned, other))
        rows.append((*place, *both, gap, "{:.2f} ({:.2f}-{:.2f})".format(*duel.probability), duel.verdict))
        verdicts.append(duel.verdict)
    counts = ", ".join(f"{verdicts.count(word)} {word}" for word in ("ahead", "behind", "not separated"))
    header = ("regime", "setting", "best learned", "best controller", f"gap [{unit.symbol}]", "P(learned is better)", "learned is")
    legend = (
        f"Errors: {unit.heading} RMS, interquartile mean with its 95 % interval / mean / p{HIGH} / share bad. "
        "Gap: the error of the best learned policy less that of the best controller on the same episodes, with the interval of the "
        "difference. Where the interval leaves out zero, the learned policy is `ahead` or `behind`. Both are chosen by these episodes, "
        "which flatters both."
    )
    return f"Learned policies: {counts}.\n\n{markdown_table(header, rows)}\n\n{legend}"


def _policy_table(found: Standings) -> str:
    """Policies: what they are, and what they know."""
    rows = []
    for entrant in found.benchmark.entrants:
        places = [place for place in found.of if entrant.label in found.of[place]]
        if places:
            members = entrant.members(found.benchmark.task)
            first = next(iter(members.values()))
            regimes = ", ".join(dict.fromkeys(place.regime for place in places))
            training = (first.training, _drawn(first)) if isinstance(first, Agent) else ("-", "-")
            count = str(len(members)) if None not in members else "-"
            rows.append((entrant.label, entrant.policy_name, regimes, model_in_the_loop(first, entrant.told), *training, count))
    header = ("method", "policy", "regimes", MODEL, "training", "domain randomisation and effects in training", "seeds")
    return markdown_table(header, rows)


def _drawn(agent: Agent) -> str:
    """Names of what domain randomisation drew in an agent's training, and of the effects that its arms had."""
    options = agent.config.options
    if options is None:
        return "not known"
    drawn = plain(options.get("randomize", {}))
    effects = resolved_scene(Options.parse(options, "options")).effects.chosen()
    return ", ".join([*(name for name in drawn if name != "effects"), *effects]) or "none"
