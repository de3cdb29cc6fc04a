"""Learning curves of the agents that ship for TipPose, over the seeds of their trainings: a picture
and a CSV file of docs/results.

    python benchmarks/learning_curves.py [--quick] [--out out]

Errors are geometric means over the validation episodes of a training that did not diverge, with
interquartile means and intervals over its seeds.
"""

from pathlib import Path

import matplotlib.pyplot as plt
from _results import markdown_table, parser_of, write_csv, write_picture

from soft_tendon_env.drawing.palette import styles
from soft_tendon_env.evaluation.entrants import trained_alike
from soft_tendon_env.evaluation.pictures import set_log_scale
from soft_tendon_env.evaluation.summaries import bootstrap_interval, interquartile_mean
from soft_tendon_env.evaluation.tables import number, with_seeds
from soft_tendon_env.learning.curves import Curves, read_curves
from soft_tendon_env.policies import PolicyName
from soft_tendon_env.policies.agent import find_agent

TASK = "TipPose"
ALGORITHMS = ("ppo", "sac", "apg")
HEADER = ("training", "seeds", "steps", "minutes", "error [mm]", "low [mm]", "high [mm]")


def main() -> None:
    arguments = parser_of(__doc__).parse_args()
    drawn = styles(ALGORITHMS)
    rows = list[tuple[object, ...]]()
    ends = list[tuple[object, ...]]()
    figure, axes = plt.subplots(figsize=(6.0, 4.0), constrained_layout=True)
    for algorithm in ALGORITHMS:
        curves = curves_of(algorithm)
        steps = curves.values("steps")[0].astype(int)
        minutes = curves.values("seconds").mean(axis=0) / 60.0
        errors = 1e3 * curves.values("typical")
        seeds = len(curves.rows)
        middle, (low, high) = interquartile_mean(errors), bootstrap_interval(errors)
        axes.plot(minutes, middle, color=drawn[algorithm].rgb, label=with_seeds(algorithm, seeds))
        axes.fill_between(minutes, low, high, color=drawn[algorithm].rgb, alpha=0.2, linewidth=0)
        rows += [
            (algorithm, seeds, *row) for row in zip(steps, minutes, middle, low, high, strict=True)
        ]
        ends.append(
            (
                algorithm,
                seeds,
                steps[-1],
                *(number(float(values[-1])) for values in (minutes, middle, low, high)),
            )
        )
    set_log_scale(axes, axes.yaxis)
    axes.set(xlabel="time of training [min]", ylabel="position [mm] RMS, validation episodes")
    axes.grid(alpha=0.3)
    axes.legend(frameon=False)
    write_csv(arguments.out / "learning_curves.csv", HEADER, rows)
    write_picture(figure, arguments.out / "learning_curves.png")
    print(f"\n{markdown_table(HEADER, ends)}\n")


def curves_of(algorithm: str) -> Curves:
    """Learning curves of an agent that ships, and of the seeds beside it."""
    agents = trained_alike(PolicyName.parse(algorithm, TASK)).values()
    return read_curves(Path(algorithm), [find_agent(name, TASK) for name in agents])


if __name__ == "__main__":
    main()
