"""The demo: the paper's controller, model-based controllers and the shipped agent on the paper's arm, on its circle and on random targets.

All arms are recorded side by side, first along the circle, then along one of the random targets. Errors count from a tenth of an episode
on. Times per action are those of the recorded episodes, which run in one process with nothing beside it.
"""

import os
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from pydantic import Field, field_validator

from soft_tendon_env.control import CONTROLLERS
from soft_tendon_env.evaluation import EVALUATION_SEEDS, EpisodeScore, Summary, summarise
from soft_tendon_env.evaluation.compare import make_runs
from soft_tendon_env.evaluation.conditions import NOMINAL
from soft_tendon_env.evaluation.settings import Comparison, Run, all_scores
from soft_tendon_env.evaluation.side_by_side import record_side_by_side
from soft_tendon_env.evaluation.sweeps import agents_of
from soft_tendon_env.evaluation.tables import full_table
from soft_tendon_env.policies.agent import SHIPPED, find_agent, is_agent
from soft_tendon_env.policies.trained_by import trained_by
from soft_tendon_env.recording import Rollout
from soft_tendon_env.tools.configuration import Configuration
from soft_tendon_env.tools.types import Positive

TASK = "TipPose"
SHOWN = ("paper", "tracking", "predictive")
ARM = {"scene": "paper", "fidelity": "standard"}
SKIPPED = 0.1  # of an episode
LEFT_OUT = ("effort [N]", "rate [N/s]", "return")
NOTES = """The tendons of this arm pull, with 0 to 60 N, and cannot push. At rest they can hold the tip only a few millimetres off the
poses of the circle, and about as much is left of the errors there; random targets are poses that the arm can hold. (39) is
continuous in time and takes tendons that push as well: as printed, held for 20 ms and cut off at 0 N, it is unstable. `tracking` is
the same law made usable; `soft-tendon reproduce-paper` shows it as the paper has it. The time is that of an action, median and
99th percentile, with that of what the agent's observation computes on the model, the inverse statics of the target."""


class Demonstration(Configuration):
    """What the demo shows.

    Attributes:
        agent: the folder or the .zip file of an agent; "agent": the one that ships.
        episodes: random targets.
        seconds: length of an episode [s].
        workers: processes.
    """

    agent: str = SHIPPED
    episodes: int = Field(default=len(EVALUATION_SEEDS), ge=1, le=len(EVALUATION_SEEDS))
    seconds: Positive = 10.0
    workers: int = Field(default=2, ge=1)

    @field_validator("agent")
    @classmethod
    def _is_agent(cls, agent: str) -> str:
        if not is_agent(agent):
            raise ValueError(f"should be the folder or the .zip file of an agent, or {SHIPPED!r} for the one that ships")
        return agent


class Kept:
    """An open RerunFile of which every episode is kept as well: rollouts, by arm."""

    def __init__(self, file: Any) -> None:
        self._file = file
        self.rollouts: dict[str, list[Rollout]] = {}
        self.path, self.add_arm, self.align = file.path, file.add_arm, file.align

    def write(self, rollout: Rollout, arm: str, *, continues: bool) -> None:
        self._file.write(rollout, arm, continues=continues)
        self.rollouts.setdefault(arm, []).append(rollout)


def demo_runs(settings: Demonstration, target: str) -> list[Run]:
    """Every policy on a target. Raises as `make_runs`."""
    given = {
        "tasks": [TASK],
        "policies": [*SHOWN, settings.agent],
        "errors": [NOMINAL],
        "episodes": settings.episodes,
        "seconds": settings.seconds,
        "skip": SKIPPED * settings.seconds,
        "options": {**ARM, "target": target},
        "workers": settings.workers,
    }
    comparison = Comparison.parse(given, "demo")
    return make_runs(comparison, TASK, agents_of(TASK, comparison.policies), comparison.errors, comparison.seeds)


def run_demo(circle: Sequence[Run], random: Sequence[Run], file: Any, workers: int, out: Path) -> str:
    """The tables of both targets; writes the recording into an open RerunFile, and OUT/demo.png. Raises OSError."""
    from soft_tendon_env.demo.picture import draw

    names = [name_of(run.policy) for run in circle]
    with file:
        kept = Kept(file)
        on_circle = record_side_by_side(first_of(circle), kept, names)
        first = record_side_by_side(first_of(random), kept, names, new=False)
    on_random = every_score(random, workers)
    draw({name: kept.rollouts[name][0] for name in names}, dict(zip(names, on_random, strict=True)), out / "demo.png")
    return tables_of(
        {name: summarise(scores) for name, scores in zip(names, on_circle, strict=True)},
        {name: with_action_times(scores, alone) for name, scores, alone in zip(names, on_random, first, strict=True)},
    )


def first_of(runs: Sequence[Run]) -> list[Run]:
    """The runs with their first episode alone."""
    return [run._replace(seeds=run.seeds[:1]) for run in runs]


def name_of(policy: str) -> str:
    """Of a policy, as tables and the recording have it."""
    return "agent" if is_agent(policy) else policy


def describe_policy(policy: str) -> str:
    if not is_agent(policy):
        return CONTROLLERS[TASK][policy].description
    return f"{trained_by(policy, TASK)}: {os.path.relpath(find_agent(policy, TASK).path)}"


def how_trained(runs: Sequence[Run]) -> str:
    """A sentence on the agents among the runs, for a page."""
    return " ".join(f"`{name_of(run.policy)}`: {trained_by(run.policy, TASK)}." for run in runs if is_agent(run.policy))


def every_score(runs: Sequence[Run], workers: int) -> list[list[EpisodeScore]]:
    """Scores of every run; each episode is a piece of work of its own."""
    pieces = [run._replace(seeds=(seed,)) for run in runs for seed in run.seeds]
    scores = iter(all_scores(pieces, workers, "random targets: policies x episodes"))
    return [[score for _ in run.seeds for score in next(scores)] for run in runs]


def with_action_times(scores: Sequence[EpisodeScore], alone: Sequence[EpisodeScore]) -> Summary:
    """Scores together, with the times per action of an episode that had the machine for itself."""
    return replace(summarise(scores), action_time=summarise(alone).action_time)


def tables_of(on_circle: dict[str, Summary], on_random: dict[str, Summary]) -> str:
    episodes = next(iter(on_random.values())).episodes
    return f"{full_table('circle', on_circle, LEFT_OUT)}\n\n{full_table(f'{episodes} random targets', on_random, LEFT_OUT)}"
