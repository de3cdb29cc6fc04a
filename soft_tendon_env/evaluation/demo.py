"""The demo: the paper's controller, model-based controllers, PPO and the best agent, on the paper's arm, its circle and random targets.

All arms are recorded side by side, first along the circle, then along one of the random targets. Errors count from a tenth of an episode
on. Times per action are those of the recorded episodes, which run in one process with nothing beside it.
"""

from dataclasses import replace
from pathlib import Path
from typing import Any

from pydantic import Field

from soft_tendon_env.evaluation.comparison import alone, make_cell, record_side_by_side, shared_arms
from soft_tendon_env.evaluation.conditions import EVALUATION_SEEDS, NOMINAL
from soft_tendon_env.evaluation.entrants import model_in_the_loop
from soft_tendon_env.evaluation.experiment import Cell, Experiment
from soft_tendon_env.evaluation.settings import EpisodeSettings, TableSettings, Workers
from soft_tendon_env.evaluation.summaries import summarise
from soft_tendon_env.evaluation.tables import summary_table
from soft_tendon_env.policies.agent_files import AGENT, AgentName, shipped_for
from soft_tendon_env.policies.names import Agent, PolicyName
from soft_tendon_env.recording import Rollout
from soft_tendon_env.tools.types import Positive

TASK = "TipPose"
SHOWN = {"paper": "paper (printed law)", "tracking": "tracking (sampled law)", "predictive": "predictive (MPC)"}
"""Controllers that are shown, with their names there."""
ARM = {"scene": "paper", "fidelity": "standard"}
NOTES = """The tendons of this arm pull, with 0 to 60 N, and cannot push. The poses that they hold at rest lie a few millimetres off
those of the circle, which is no lower limit of the error of a moving arm. Random targets are poses that the arm can hold. The law (39)
of the paper is continuous in time and takes tendons that push as well: as printed, held for 20 ms and cut off at 0 N, it is unstable.
`tracking` is the same law for sampled commands and tendons that only pull; `soft-tendon reproduce-paper` shows it as the paper has it."""


class Demonstration(Workers, TableSettings):
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
        names = {Agent(name, TASK).folder: name for name in (*(["ppo"] if "ppo" in shipped_for(TASK) else []), self.agent)}
        trained = {name: Agent(name, TASK).training.partition(",")[0] for name in names.values()}
        return SHOWN | {name: f"agent ({own})" if name == self.agent else own for name, own in trained.items()}

    def cells(self, target: str) -> dict[str, Cell]:
        """Every policy on a target, by its name in tables. Raises ValueError, OSError for what is none."""
        settings = EpisodeSettings(seconds=self.seconds, skip=0.1 * self.seconds, options={**ARM, "target": target})
        names, seeds = self.policies, EVALUATION_SEEDS[: self.episodes]
        arms = shared_arms(settings, TASK, names)
        return {names[policy]: make_cell(settings, seeds, TASK, policy, options, NOMINAL) for policy, options in arms.items()}


class FirstEpisodes:
    """An open RerunFile that keeps the first episode of every arm too, as a rollout."""

    def __init__(self, file: Any) -> None:
        self._file, self.rollouts = file, dict[str, Rollout]()

    def write(self, rollout: Rollout, arm: str, *, continues: bool) -> None:
        """Writes an episode, see RerunFile.write."""
        self._file.write(rollout, arm, continues=continues)
        self.rollouts.setdefault(arm, rollout)

    def __getattr__(self, name: str) -> Any:
        return getattr(self._file, name)


def run_demo(settings: Demonstration, file: Any, out: Path) -> str:
    """Tables of both targets; writes the recording into an open RerunFile, and demo.png and the episodes into a folder.

    Raises ValueError, OSError.
    """
    from soft_tendon_env.evaluation.pictures import draw_demo

    circle, random = settings.cells("circle"), settings.cells("random")
    pieces = {(name, seed): cell._replace(seeds=(seed,)) for name, cell in random.items() for seed in cell.seeds}
    experiment, players = Experiment(pieces, out / "cells"), [[alone(cell).open() for cell in of.values()] for of in (circle, random)]
    names, seeds, skip = [*random], EVALUATION_SEEDS[:1], 0.1 * settings.seconds
    with file:
        kept = FirstEpisodes(file)
        on_circle, first = (record_side_by_side(own, kept, names, seeds, skip, new=k == 0) for k, own in enumerate(players))
    experiment.play("random targets: policies x episodes", settings.workers, settings.cluster)
    on_random = {name: [experiment.scores((name, seed))[0] for seed in cell.seeds] for name, cell in random.items()}
    draw_demo(kept.rollouts, on_random, out / "demo.png")
    times = {name: summarise(scores).action_time for name, scores in zip(names, first, strict=True)}
    tables = {
        "circle": {name: summarise(scores) for name, scores in zip(names, on_circle, strict=True)},
        f"{settings.episodes} random targets": {name: replace(summarise(on_random[name]), action_time=times[name]) for name in names},
    }
    models = {name: model_in_the_loop(PolicyName.parse(policy, TASK)) for policy, name in settings.policies.items()}
    return "\n\n".join(summary_table(label, summaries, settings.all, models) for label, summaries in tables.items())
