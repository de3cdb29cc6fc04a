"""Cost of a limit of the actuators' rate to each policy: a table of
docs/results/learned_against_model_based.md.

    python benchmarks/rate_limit.py [--rate 150] [--episodes 24] [--workers 2] [--quick] [--out out]

Every policy plays the same episodes twice: with commands that may jump, and with commands that the
actuators let change by at most the rate. Differences are of interquartile means over paired
episodes, with their 95 % intervals. Coordinates are observed; filtered: has exact sensors in their
place. The arm is that of `standard`.
"""

from typing import Any, NamedTuple

from _results import markdown_table, parser_of, write_csv, write_tables

from soft_tendon_env.evaluation.benchmark import TARGET
from soft_tendon_env.evaluation.conditions import SEEDS, SETTINGS
from soft_tendon_env.evaluation.experiment import Cell, Experiment
from soft_tendon_env.evaluation.summaries import Mean, Standing, difference
from soft_tendon_env.evaluation.tables import number
from soft_tendon_env.policies.names import PolicyName

TASK = "TipPose"
RATE = 150.0  # [N/s] that the increments of APG reach, which are the largest of agents that ship
POLICIES = (
    "feedforward",
    "tracking",
    "predictive",
    "filtered:predictive@standard",
)
"""Controllers alone: agents change their commands by at most that rate anyway."""
SETTING_NAMES = ("nominal", "hard")
SECONDS = 4.0  # length of an episode, as in configs/published.toml
SKIP = 1.0  # [s] from which on errors count, likewise
MILLIMETRES = 1e3
HEADER = (
    "policy",
    "setting",
    "position [mm], without a limit",
    "with it",
    "difference",
    "return, without a limit",
    "with it",
    "difference",
    "bad, without and with it",
)


class Label(NamedTuple):
    """Name of a cell; rate None: without a limit."""

    policy: str
    setting: str
    rate: float | None


def main() -> None:
    parser = parser_of(__doc__)
    parser.add_argument("--rate", type=float, default=RATE, help="rate limit [N/s]")
    parser.add_argument("--episodes", type=int, default=24, help="episodes of a policy and setting")
    parser.add_argument("--workers", type=int, default=2, help="processes side by side")
    arguments = parser.parse_args()
    policies = POLICIES[:2] if arguments.quick else POLICIES
    episodes = 2 if arguments.quick else arguments.episodes
    seconds = 1.2 if arguments.quick else SECONDS
    cells = {}
    for policy in policies:
        for setting in SETTING_NAMES:
            for rate in (None, arguments.rate):
                cell = make_cell(policy, setting, rate, episodes, seconds)
                cells[Label(policy, setting, rate)] = cell
    experiment = Experiment(cells, arguments.out / "rate_limit_cells")
    experiment.play("rate limit", arguments.workers, None)
    rows = []
    for policy in policies:
        for setting in SETTING_NAMES:
            jumping = standing(experiment, Label(policy, setting, None))
            limited = standing(experiment, Label(policy, setting, arguments.rate))
            rows.append([policy, setting, *costs(jumping, limited)])
    write_csv(arguments.out / "rate_limit.csv", HEADER, rows)
    text = f"{episodes} episodes of {seconds:g} s, with a limit of {arguments.rate:g} N/s."
    write_tables(arguments.out / "rate_limit.md", f"{text}\n\n{markdown_table(HEADER, rows)}")


def make_cell(policy: str, setting: str, rate: float | None, episodes: int, seconds: float) -> Cell:
    """Episodes of a policy in a setting, with commands of at most a rate [N/s]."""
    observed = PolicyName.parse(policy, TASK).options({})
    nominal: dict[str, Any] = {
        **observed,
        **TARGET,
        "scene": "paper",
        "fidelity": "standard",
        "rate_limit": rate,
        "randomize": {},
    }
    options = SETTINGS[setting].options(nominal)
    believed = {"scene": "paper"}
    seeds = tuple(SEEDS["arena"][:episodes])
    return Cell(TASK, policy, options, seeds, seconds, SKIP, controller_scene=believed)


def standing(experiment: Experiment[Label], label: Label) -> Standing:
    """Scores of a cell, as of a policy of one member."""
    return Standing([experiment.scores(label)])


def costs(jumping: Standing, limited: Standing) -> list[str]:
    """Cells of a row: errors, returns and shares of bad episodes, without and with the limit."""
    cells = []
    for key, factor in ((f"{jumping.error}_rms", MILLIMETRES), ("return", 1.0)):
        for side in (jumping, limited):
            cells.append(number(factor * side.mean(key).value))
        cells.append(interval_text(difference(limited, jumping, key), factor))
    bad = []
    for side in (jumping, limited):
        count = sum(score.bad for score in side.episodes)
        bad.append(f"{100 * count / len(side.episodes):.0f} %")
    return [*cells, ", ".join(bad)]


def interval_text(mean: Mean, factor: float) -> str:
    """A difference with its interval."""
    value, low, high = (number(factor * part) for part in mean)
    return f"{value} ({low} to {high})"


if __name__ == "__main__":
    main()
