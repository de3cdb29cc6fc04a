"""The demo: the paper's controller, model-based controllers, PPO and the best agent, on the paper's arm, its circle and random targets.

All arms are recorded side by side, first along the circle, then along one of the random targets, which also gives the times per action.
"""

from pathlib import Path
from typing import Any

from pydantic import Field

from soft_tendon_env.evaluation.comparison import TIME, compare, record_side_by_side, shared_arms, standings_of
from soft_tendon_env.evaluation.conditions import EVALUATION_SEEDS, NOMINAL
from soft_tendon_env.evaluation.entrants import model_in_the_loop
from soft_tendon_env.evaluation.experiment import Experiment
from soft_tendon_env.evaluation.settings import Settings, Workers
from soft_tendon_env.evaluation.summaries import Standing
from soft_tendon_env.evaluation.tables import summary_table
from soft_tendon_env.policies.agent_files import AGENT, AgentName, shipped_for
from soft_tendon_env.policies.names import Agent, PolicyName
from soft_tendon_env.tools.types import Positive

TASK = "TipPose"
SHOWN = {"paper": "paper (printed law)", "tracking": "tracking (sampled law)", "predictive": "predictive (MPC)"}
"""Controllers that are shown, with their names there."""
ARM = {"scene": "paper", "fidelity": "standard"}
NOTES = """The tendons of this arm pull, with 0 to 60 N, and cannot push. The law (39) of the paper is continuous in time and takes tendons
that push as well: as printed, held for 20 ms and cut off at 0 N, it is unstable. `tracking` is the same law for sampled commands and
tendons that only pull; `soft-tendon reproduce-paper` shows it as the paper has it."""


class Demonstration(Workers):
    """Episodes of the demo, and the agent in it.

    Attributes:
        agent: the folder of an agent; or agent, ppo, sac, dagger or apg, of those that ship.
        episodes: number of random targets.
        seconds: length of an episode [s].
    """

    agent: AgentName = AGENT
    episodes: int = Field(default=len(EVALUATION_SEEDS), ge=1, le=len(EVALUATION_SEEDS))
    seconds: Positive = 10.0

    @property
    def policies(self) -> dict[str, str]:
        """Policies that are shown, and their names there, which say what they are. Raises ValueError, OSError."""
        trained = Agent(self.agent, TASK).training.partition(",")[0]
        return {**SHOWN, **({"ppo": "PPO"} if "ppo" in shipped_for(TASK) else {}), self.agent: f"agent ({trained})"}


def run_demo(settings: Demonstration, file: Any, out: Path) -> str:
    """Tables of both targets; writes the recording into an open RerunFile, and demo.png and the episodes into a folder.

    Raises ValueError, OSError.
    """
    from soft_tendon_env.evaluation.pictures import draw_errors

    names, tables, standings = settings.policies, list[str](), dict[tuple[str, str], Standing]()
    files: dict[str, dict[int | None, str]] = {name: {None: policy} for policy, name in names.items()}
    models = {name: model_in_the_loop(PolicyName.parse(policy, TASK)) for policy, name in names.items()}
    experiments = dict[str, Experiment[tuple[str, str]]]()
    for target, episodes in (("circle", 1), ("random", settings.episodes)):
        length = {"seconds": settings.seconds, "skip": 0.1 * settings.seconds}
        own = Settings.parse({**length, "errors": (NOMINAL,), "episodes": episodes, "options": {**ARM, "target": target}}, "demo")
        label = target if target == "circle" else f"{episodes} random targets"
        experiments[label] = compare(own, TASK, shared_arms(own, TASK, names), out / "cells")
    with file:
        for label, experiment in experiments.items():
            players = {name: experiment.cells[policy, TIME].open() for policy, name in names.items()}
            record_side_by_side(players, file, EVALUATION_SEEDS[:1], 0.0, new=label == "circle")
    for label, experiment in experiments.items():
        experiment.play(label, settings.workers, settings.cluster)
        found, summaries = standings_of(experiment, files)
        tables.append(summary_table(label, {name: summaries[name, NOMINAL] for name in files}, models))
        standings |= {(name, label): standing for (name, _), standing in found.items()}
    draw_errors({TASK: standings}, out / "demo.png")
    return "\n\n".join(tables)
