"""Page of the benchmark: its tables in Markdown."""

from soft_tendon_env.envs.options import Options, resolved_scene
from soft_tendon_env.envs.tracking import error_unit
from soft_tendon_env.evaluation.benchmark import Results
from soft_tendon_env.evaluation.entrants import model_in_the_loop
from soft_tendon_env.evaluation.tables import ERRORS_LEGEND, MODEL, error_table, error_text, markdown_table, number
from soft_tendon_env.policies.names import Agent
from soft_tendon_env.policies.regimes import REGIMES
from soft_tendon_env.tools.configuration import plain


def benchmark_tables(found: Results) -> str:
    """The whole page."""
    regimes = (f"### {regime}\n\n{REGIMES[regime].description.capitalize()}.\n\n{error_table(of)}" for regime, of in found.of.items())
    return "\n\n".join([_duel_table(found), _policy_table(found), *regimes])


def _duel_table(found: Results) -> str:
    """Best learned beside best model-based policy, by condition, and how often it is ahead."""
    rows, verdicts = [], list[str]()
    for regime, setting, (learned, one), (controller, other), duel in found.duels():
        unit = error_unit(one.error)
        gap = "{} ({} to {})".format(*(number(unit.factor * value) for value in duel.difference))
        both = f"{learned} {error_text(one)}", f"{controller} {error_text(other)}"
        rows.append((regime, setting, *both, gap, "{:.2f} ({:.2f}-{:.2f})".format(*duel.probability), duel.verdict))
        verdicts.append(duel.verdict)
    if not rows:
        return "Nobody plays against another kind of policy."
    counts = ", ".join(f"{verdicts.count(word)} {word}" for word in ("ahead", "behind", "not separated"))
    header = ("regime", "setting", "best learned", "best controller", f"gap [{unit.symbol}]", "P(learned is better)", "learned is")
    legend = (
        "Gap: the error of the best learned policy less that of the best controller on the same episodes, with the interval of the "
        "difference. Where the interval leaves out zero, the learned policy is `ahead` or `behind`. Both are chosen by these episodes, "
        "which flatters both."
    )
    return f"Learned policies: {counts}.\n\n{markdown_table(header, rows)}\n\n{ERRORS_LEGEND} {legend}"


def _policy_table(found: Results) -> str:
    """Policies: what they are, and what they know."""
    rows = []
    for entrant in found.benchmark.entrants:
        members = entrant.members(found.benchmark.task)
        first, drawn = next(iter(members.values())), "-"
        regimes = ", ".join(regime for regime, of in found.of.items() if any(name == entrant.label for name, _ in of))
        if isinstance(first, Agent) and first.config.options is not None:
            effects = resolved_scene(Options(**first.config.options)).effects.chosen()
            drawn = (
                ", ".join([*(name for name in plain(first.config.options.get("randomize", {})) if name != "effects"), *effects]) or "none"
            )
        training = (first.training, drawn) if isinstance(first, Agent) else ("-", "-")
        count = "-" if None in members else str(len(members))
        rows.append((entrant.label, entrant.policy_name, regimes, model_in_the_loop(first, entrant.told), *training, count))
    header = ("method", "policy", "regimes", MODEL, "training", "domain randomisation and effects in training", "seeds")
    return markdown_table(header, rows)
