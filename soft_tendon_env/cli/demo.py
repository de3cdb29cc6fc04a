"""`soft-tendon demo`: the paper's controller, model-based controllers, PPO and the agent that
ships, side by side on the paper's arm.

All arms are recorded side by side, first along the circle, then along one of the random targets.
The picture shows the recorded circle and the numbers of the tables.
"""

from pathlib import Path
from typing import TYPE_CHECKING

from pydantic import Field

from soft_tendon_env.cli.errors import mistakes, require, writable_folder
from soft_tendon_env.control import controllers_of
from soft_tendon_env.envs.tracking import error_unit
from soft_tendon_env.evaluation.comparison import (
    TIME,
    Files,
    compare,
    opening_hint,
    record_side_by_side,
    shared_arms,
    standings_of,
)
from soft_tendon_env.evaluation.conditions import EVALUATION_SEEDS, NOMINAL
from soft_tendon_env.evaluation.entrants import model_in_the_loop
from soft_tendon_env.evaluation.experiment import Experiment
from soft_tendon_env.evaluation.settings import Settings, Workers
from soft_tendon_env.evaluation.summaries import Summary
from soft_tendon_env.evaluation.tables import summary_cells, summary_table, write_markdown
from soft_tendon_env.policies.agent import AGENT, AgentConfig
from soft_tendon_env.policies.names import Agent, PolicyName
from soft_tendon_env.recording import Rollout
from soft_tendon_env.tools.parallel import check_cluster
from soft_tendon_env.tools.types import Positive

if TYPE_CHECKING:
    from soft_tendon_env.recording.rerun_file import RerunFile

TASK = "TipPose"
ERROR = "position_error"  # that the picture shows over time
SKIPPED = 0.1  # share of an episode, at its beginning, that errors leave out
SHOWN = {
    "paper": "paper (printed law)",
    "tracking": "tracking (sampled law)",
    "predictive": "predictive (MPC)",
    "ppo": "PPO",
}
SHOWN[AGENT] = "agent (APG)"
"""Policies that are shown, with their names there."""
ARM = {"scene": "paper", "fidelity": "standard"}
NOTES = """The tendons of this arm pull, with 0 to 60 N, and cannot push. The law (39) of the paper
is continuous in time and takes tendons that push as well: as printed, held for 20 ms and cut off at
0 N, it is unstable. `tracking` is the same law for sampled commands and tendons that only pull;
`soft-tendon reproduce-paper` shows it as the paper has it. An episode is settled when the error of
the tip falls below 1 % of the arm's length, here 10 mm, and stays there to the end."""


class Demo(Workers):
    """Print the errors of controllers and agents, and write them, a picture and a recording for the
    Rerun viewer."""

    episodes: int = Field(
        default=len(EVALUATION_SEEDS),
        ge=1,
        le=len(EVALUATION_SEEDS),
        description="number of random targets",
    )
    seconds: Positive = Field(default=10.0, description="length of an episode [s]")
    out: str = Field(
        default="out",
        description="folder of tables, picture, recording and the episodes that were played",
    )


def run(settings: Demo) -> None:
    """Run all policies, print and write."""
    out = Path(settings.out)
    known = controllers_of(TASK)
    with mistakes():
        require("pictures", "recording")
        check_cluster(settings.cluster)
        from soft_tendon_env.recording.rerun_file import RerunFile  # imports Rerun

        file = RerunFile(writable_folder(out) / "demo.rrd")
        configs = {
            name: Agent(policy, TASK, policy).config
            for policy, name in SHOWN.items()
            if policy not in known
        }
        agents = {name: _training(config) for name, config in configs.items()}
    described = {
        name: agents.get(name) or known[policy].description for policy, name in SHOWN.items()
    }
    lines = (f"{name:<24} {text}" for name, text in described.items())
    print("\n".join(lines), "\n")
    tables = play(settings, file, out)
    shown = f"{tables}\n\n{NOTES}"
    print(f"{shown}\n")
    sentences = (f"{name}: {text}" for name, text in agents.items())
    trained = "; ".join(sentences)
    report = f"Episodes of {settings.seconds:g} s. {trained}.\n\n{shown}"
    write_markdown(out / "demo.md", report)
    print(opening_hint(out / "demo.rrd"))


def _training(config: AgentConfig) -> str:
    """How an agent was trained."""
    steps = f"{config.algorithm}, {config.steps_done:,} steps"
    if config.start_from is None:
        return steps
    return f"{steps} after an earlier training"


def play(settings: Demo, file: "RerunFile", out: Path) -> str:
    """Tables of both targets; writes the recording into an open file, and demo.png and the episodes
    into a folder."""
    from soft_tendon_env.evaluation.overview import Overview, draw_overview

    files: dict[str, dict[int | None, str]] = {
        name: {None: policy} for policy, name in SHOWN.items()
    }
    models = {
        name: model_in_the_loop(PolicyName.parse(policy, TASK)) for policy, name in SHOWN.items()
    }
    circle = "circle"
    random = f"{settings.episodes} random targets"
    # both are made before the first is played: what is wrong is said before anything takes long
    experiments = {
        circle: make_experiment(settings, files, "circle", 1, out),
        random: make_experiment(settings, files, "random", settings.episodes, out),
    }
    tables = list[str]()
    rollouts = dict[str, dict[str, Rollout]]()
    summaries = dict[str, dict[str, Summary]]()
    with file:
        for label, experiment in experiments.items():
            players = {
                name: experiment.cells[policy, TIME].open() for policy, name in SHOWN.items()
            }
            recorded = record_side_by_side(
                players,
                file,
                EVALUATION_SEEDS[:1],
                skip=0.0,
                label=f"{label}: recording",
                new=label == circle,
            )
            rollouts[label] = recorded.rollouts
            experiment.play(label, settings.workers, settings.cluster)
            _, by_error = standings_of(experiment, files)
            summaries[label] = {name: by_error[name, NOMINAL] for name in files}
            table = summary_table(label, summaries[label], models)
            tables.append(table)
    overview = Overview(
        headline="One arm, five policies, one circle",
        rollouts=rollouts[circle],
        bent=SHOWN[AGENT],
        error=ERROR,
        numbers={
            name: numbers_in_picture(summaries[circle][name], summaries[random][name])
            for name in files
        },
    )
    draw_overview(overview, out / "demo.png")
    return "\n\n".join(tables)


def make_experiment(
    settings: Demo, files: Files, target: str, episodes: int, out: Path
) -> Experiment[tuple[str, str]]:
    """Experiment of all policies on a target, whose results are kept in a folder."""
    options = {
        "seconds": settings.seconds,
        "skip": SKIPPED * settings.seconds,
        "errors": (NOMINAL,),
        "episodes": episodes,
        "options": {**ARM, "target": target},
    }
    chosen = Settings.parse(options, "demo")
    arms = shared_arms(chosen, TASK, files)
    return compare(chosen, TASK, arms, out / "cells")


def numbers_in_picture(circle: Summary, random: Summary) -> dict[str, str]:
    """Cells of a policy's row in the picture by heading, as the tables have them."""
    position = error_unit(ERROR)
    angle = error_unit("angle_error")
    on_circle = summary_cells(circle)
    on_random = summary_cells(random)
    return {
        f"circle\n[{position.symbol}]": on_circle[f"{position.heading} RMS"],
        f"random\n[{position.symbol}]": on_random[f"{position.heading} RMS"],
        f"random\n[{angle.symbol}]": on_random[f"{angle.heading} RMS"],
        "action\n[ms]": on_random["time [ms]"],
    }
