"""The demo: the paper's controller, model-based controllers, PPO and the agent that ships, on the circle and on random targets.

All arms are recorded side by side, first along the circle, then along one of the random targets, which also gives the times per action.
"""

from pathlib import Path
from typing import Any

from soft_tendon_env.evaluation.comparison import TIME, compare, record_side_by_side, shared_arms, standings_of
from soft_tendon_env.evaluation.conditions import EVALUATION_SEEDS, NOMINAL
from soft_tendon_env.evaluation.entrants import model_in_the_loop
from soft_tendon_env.evaluation.experiment import Experiment
from soft_tendon_env.evaluation.settings import Settings, Workers
from soft_tendon_env.evaluation.summaries import Standing
from soft_tendon_env.evaluation.tables import summary_table
from soft_tendon_env.policies.agent import AGENT
from soft_tendon_env.policies.names import PolicyName

TASK = "TipPose"
SHOWN = {"paper": "paper (printed law)", "tracking": "tracking (sampled law)", "predictive": "predictive (MPC)", "ppo": "PPO"}
SHOWN[AGENT] = "agent (APG)"
"""Policies that are shown, with their names there."""
ARM = {"scene": "paper", "fidelity": "standard"}
NOTES = """The tendons of this arm pull, with 0 to 60 N, and cannot push. The law (39) of the paper is continuous in time and takes tendons
that push as well: as printed, held for 20 ms and cut off at 0 N, it is unstable. `tracking` is the same law for sampled commands and
tendons that only pull; `soft-tendon reproduce-paper` shows it as the paper has it. An episode is settled when the error of the tip falls
below 1 % of the arm's length, here 10 mm, and stays there to the end."""


def run_demo(episodes: int, seconds: float, workers: Workers, file: Any, out: Path) -> str:
    """Tables of both targets, one of them with so many random ones, for so long [s]; writes the recording into an open RerunFile, and
    demo.png and the episodes into a folder. Raises ValueError, OSError."""
    from soft_tendon_env.evaluation.pictures import draw_errors

    tables, standings = list[str](), dict[tuple[str, str], Standing]()
    files: dict[str, dict[int | None, str]] = {name: {None: policy} for policy, name in SHOWN.items()}
    models = {name: model_in_the_loop(PolicyName.parse(policy, TASK)) for policy, name in SHOWN.items()}
    experiments = dict[str, Experiment[tuple[str, str]]]()
    for target, count, label in (("circle", 1, "circle"), ("random", episodes, f"{episodes} random targets")):
        given = {"seconds": seconds, "skip": 0.1 * seconds, "errors": (NOMINAL,), "episodes": count, "options": {**ARM, "target": target}}
        chosen = Settings.parse(given, "demo")
        experiments[label] = compare(chosen, TASK, shared_arms(chosen, TASK, files), out / "cells")
    with file:
        for label, experiment in experiments.items():
            players = {name: experiment.cells[policy, TIME].open() for policy, name in SHOWN.items()}
            record_side_by_side(players, file, EVALUATION_SEEDS[:1], 0.0, new=label == "circle")
            experiment.play(label, workers.workers, workers.cluster)
            found, summaries = standings_of(experiment, files)
            tables.append(summary_table(label, {name: summaries[name, NOMINAL] for name in files}, models))
            standings |= {(name, label): standing for (name, _), standing in found.items()}
    draw_errors({TASK: standings}, out / "demo.png")
    return "\n\n".join(tables)
