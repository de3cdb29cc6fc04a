"""Learning curves of three agents for TipPose over the seeds of their trainings.

    python benchmarks/learning_curves.py [--seeds 5] [--steps 1000000] [--quick] [--out out]

A picture and a CSV file of docs/results. PPO and SAC are the agents that ship, with the curves of
their trainings. APG learns here, by `configs/apg_tip_pose.toml` with fewer steps: in OUT a training
that is complete is not repeated, and an interrupted one goes on. Errors are geometric means over
the validation episodes of a training that did not diverge, with interquartile means and intervals
over its seeds.
"""

import sys
from pathlib import Path

import matplotlib.pyplot as plt
from _results import markdown_table, parser_of, write_csv, write_picture

from soft_tendon_env.drawing.palette import styles
from soft_tendon_env.evaluation.entrants import trained_alike
from soft_tendon_env.evaluation.pictures import set_log_scale
from soft_tendon_env.evaluation.summaries import bootstrap_interval, interquartile_mean
from soft_tendon_env.evaluation.tables import number, with_seeds
from soft_tendon_env.learning import sweep
from soft_tendon_env.learning.config import find_config, read_training
from soft_tendon_env.learning.curves import Curves, read_curves
from soft_tendon_env.policies import PolicyName
from soft_tendon_env.policies.agent import find_agent

TASK = "TipPose"
SHIPPED = ("ppo", "sac")
TRAINED = "apg"
CONFIG = "apg_tip_pose"
EVALUATIONS = 8
"""Evaluations of a training, besides that at its beginning."""
HEADER = ("training", "seeds", "steps", "minutes", "error [mm]", "low [mm]", "high [mm]")


def main() -> None:
    parser = parser_of(__doc__)
    parser.add_argument("--seeds", type=int, default=5, help="trainings of APG")
    parser.add_argument("--steps", type=int, default=1_000_000, help="steps of each")
    arguments = parser.parse_args()
    seeds = 2 if arguments.quick else arguments.seeds
    steps = 500 if arguments.quick else arguments.steps
    folder = arguments.out / "learning_curves" / f"{steps}_steps" / CONFIG
    trained = train_seeds(folder, seeds, steps)
    every_curve = {algorithm: curves_of(algorithm) for algorithm in SHIPPED}
    every_curve[TRAINED] = read_curves(folder, trained)
    drawn = styles(every_curve)
    rows = list[tuple[object, ...]]()
    ends = list[tuple[object, ...]]()
    figure, axes = plt.subplots(figsize=(6.0, 4.0), constrained_layout=True)
    for algorithm, curves in every_curve.items():
        steps_done = curves.values("steps")[0].astype(int)
        minutes = curves.values("seconds").mean(axis=0) / 60.0
        errors = 1e3 * curves.values("typical")
        count = len(curves.rows)
        middle, (low, high) = interquartile_mean(errors), bootstrap_interval(errors)
        label = with_seeds(algorithm.upper(), count)
        axes.plot(minutes, middle, color=drawn[algorithm].rgb, label=label)
        axes.fill_between(minutes, low, high, color=drawn[algorithm].rgb, alpha=0.2, linewidth=0)
        rows += [
            (algorithm, count, *row)
            for row in zip(steps_done, minutes, middle, low, high, strict=True)
        ]
        ends.append(
            (
                algorithm,
                count,
                steps_done[-1],
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


def train_seeds(folder: Path, seeds: int, steps: int) -> list[Path]:
    """Folders seed_0, seed_1, ... of trainings of APG, of which what is missing is learned."""
    folders = []
    for seed in range(seeds):
        training = read_training(
            find_config(CONFIG),
            [f"evaluation.every={steps // EVALUATIONS}"],
            steps=steps,
            seed=seed,
        )
        job = sweep.Job(training, folder / f"seed_{seed}")
        error = sweep.run_job(job)
        if error is not None:
            sys.exit(error)
        folders.append(job.folder)
    return folders


def curves_of(algorithm: str) -> Curves:
    """Learning curves of an agent that ships, and of the seeds beside it."""
    agents = trained_alike(PolicyName.parse(algorithm, TASK)).values()
    return read_curves(Path(algorithm), [find_agent(name, TASK) for name in agents])


if __name__ == "__main__":
    main()
