"""Learning curves of the agents that ship for TipPose, over the seeds of their trainings: a picture and a CSV file of docs/results.

    python benchmarks/learning_curves.py [--quick] [--write-docs] [--out out]

Errors are geometric means over the validation episodes of a training that did not diverge, with interquartile means and intervals over its
seeds.
"""

from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
from _results import markdown_table, parser_of, write_csv

from soft_tendon_env.drawing.palette import styles
from soft_tendon_env.evaluation.entrants import trained_alike
from soft_tendon_env.evaluation.pictures import set_log_scale
from soft_tendon_env.evaluation.summaries import bootstrap_interval, interquartile_mean
from soft_tendon_env.evaluation.tables import number, with_seeds
from soft_tendon_env.learning.curves import read_curves
from soft_tendon_env.policies import PolicyName
from soft_tendon_env.policies.agent import find_agent

TASK, ALGORITHMS, CURVE = "TipPose", ("ppo", "sac", "apg"), "evaluations.csv"
RESULTS = Path(__file__).parent.parent / "docs" / "results"
HEADER = ("training", "seeds", "steps", "minutes", "error [mm]", "low [mm]", "high [mm]")


def main() -> None:
    arguments = parser_of(__doc__).parse_args()
    rows, drawn = [row for algorithm in ALGORITHMS for row in rows_of(algorithm)], styles(ALGORITHMS)
    figure, axes = plt.subplots(figsize=(6.0, 4.0), constrained_layout=True)
    ends = []
    for algorithm in dict.fromkeys(row[0] for row in rows):
        of = [row for row in rows if row[0] == algorithm]
        minutes, middle, low, high = np.array([row[3:] for row in of]).T
        axes.plot(minutes, middle, color=drawn[algorithm].rgb, label=with_seeds(algorithm, of[0][1]))
        axes.fill_between(minutes, low, high, color=drawn[algorithm].rgb, alpha=0.2, linewidth=0)
        ends.append((*of[-1][:3], *map(number, of[-1][3:])))
    set_log_scale(axes, axes.yaxis)
    axes.set(xlabel="time of training [min]", ylabel="position [mm] RMS, validation episodes")
    axes.grid(alpha=0.3)
    axes.legend(frameon=False)
    for folder in [arguments.out, *([RESULTS] if arguments.write_docs else [])]:
        write_csv(folder / "learning_curves.csv", HEADER, rows)
        figure.savefig(folder / "learning_curves.png", dpi=130)
    print(f"\n{markdown_table(HEADER, ends)}\n")


def rows_of(algorithm: str) -> list[tuple[str, int, int, float, float, float, float]]:
    """Rows of a training's curve, of the seeds that have one."""
    agents = trained_alike(PolicyName.parse(algorithm, TASK)).values()
    folders = [folder for name in agents if (folder := find_agent(name, TASK)) and (folder / CURVE).exists()]
    if not folders:
        return []
    curves = read_curves(Path(algorithm), folders)
    errors, minutes = 1e3 * curves.values("typical"), curves.values("seconds").mean(axis=0) / 60.0
    found = zip(
        curves.values("steps")[0].astype(int).tolist(), minutes, interquartile_mean(errors), *bootstrap_interval(errors), strict=True
    )
    return [(algorithm, len(folders), steps, *map(float, others)) for steps, *others in found]


if __name__ == "__main__":
    main()
