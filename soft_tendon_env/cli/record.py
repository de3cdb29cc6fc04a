"""`soft-tendon record`: policies side by side in one recording for the Rerun viewer."""

from collections.abc import Sequence
from pathlib import Path

from pydantic import Field

from soft_tendon_env import recording
from soft_tendon_env.cli.errors import require
from soft_tendon_env.cli.options import Parser
from soft_tendon_env.evaluation.comparison import alone, make_cell, opening_hint, print_caveats, record_side_by_side, shared_arms
from soft_tendon_env.evaluation.conditions import EVALUATION_SEEDS, NOMINAL
from soft_tendon_env.evaluation.entrants import agents_of, every_file, model_in_the_loop
from soft_tendon_env.evaluation.provenance import machine
from soft_tendon_env.evaluation.settings import EpisodeSettings, Seeds, TaskName
from soft_tendon_env.evaluation.summaries import summarise
from soft_tendon_env.evaluation.tables import summary_table
from soft_tendon_env.policies.names import PolicyName

STOPPED = "stopped: the recording ends with the last whole episode"


class Record(EpisodeSettings):
    """Print the errors of policies, and write a file for the Rerun viewer in which each has an arm of its name.

    Attributes:
        policies: names of controllers, or filtered:NAME; folders or .zip files of agents; ppo, sac, dagger or apg, of those that
            ship for the task; agent, the best of these.
        task: name of the task: TipPose, Shape, Reach, or one that was registered.
        seeds: seeds of the episodes, which are played one after another.
        out: file of the recording.
    """

    policies: tuple[str, ...] = Field(min_length=1)
    task: TaskName = "TipPose"
    seeds: Seeds = Field(default=EVALUATION_SEEDS[:1], min_length=1)
    out: str = "out/side_by_side.rrd"


def run(arguments: Sequence[str]) -> None:
    """Record and print."""
    parser = Parser("record", Record)
    settings = parser.read(arguments)
    task, out = settings.task, Path(settings.out)
    with parser.mistakes():
        require("recording")
        arms = shared_arms(settings, task, every_file(agents_of(task, settings.policies)))
        players = {name: alone(make_cell(settings, settings.seeds, task, name, own, NOMINAL)).open() for name, own in arms.items()}
        print_caveats(settings, {task: arms})
        file = recording.RerunFile(out)
    print(f"{task}, episodes of {settings.seconds:g} s from seeds {', '.join(map(str, settings.seeds))}; {machine()}\n")
    with file:
        scores = record_side_by_side(players, file, settings.seeds, settings.skip)
    summaries = {policy: summarise(of_policy) for policy, of_policy in scores.items()}
    models = {policy: model_in_the_loop(PolicyName.parse(policy, task)) for policy in summaries}
    print(f"{summary_table('policy', summaries, models)}\n\n{opening_hint(out)}")
