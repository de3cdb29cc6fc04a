"""`soft-tendon record`: policies side by side in one recording for the Rerun viewer."""

from pathlib import Path

from pydantic import Field
from tyro.conf import Positional

from soft_tendon_env.cli.errors import mistakes, require
from soft_tendon_env.cli.options import POLICY, TASK, EnvironmentArguments
from soft_tendon_env.evaluation import comparison, provenance, tables
from soft_tendon_env.evaluation.conditions import EVALUATION_SEEDS
from soft_tendon_env.evaluation.entrants import agents_of, model_in_the_loop
from soft_tendon_env.evaluation.settings import EpisodeSettings, Seeds, TaskName
from soft_tendon_env.evaluation.summaries import summarise
from soft_tendon_env.policies.names import PolicyName


class Record(EnvironmentArguments, EpisodeSettings):
    """Print the errors of policies, and write a file for the Rerun viewer in which each has an arm
    of its name."""

    policies: Positional[tuple[str, ...]] = Field(min_length=1, description=POLICY)
    task: TaskName = Field(default="TipPose", description=TASK)
    seeds: Seeds = Field(
        default=EVALUATION_SEEDS[:1],
        min_length=1,
        description="seeds of the episodes, which are played in turn",
    )
    out: str = Field(default="out/side_by_side.rrd", description="file of the recording")


def run(settings: Record) -> None:
    """Record and print."""
    task = settings.task
    out = Path(settings.out)
    with mistakes():
        require("recording")
        policies = agents_of(task, settings.policies)
        players = {}
        for name, arm in comparison.shared_arms(settings, task, policies).items():
            cell = comparison.make_cell(settings, settings.seeds, task, name, arm)
            players[name] = cell.open()
        from soft_tendon_env.recording.rerun_file import RerunFile  # imports Rerun

        file = RerunFile(out)
    seeds = ", ".join(map(str, settings.seeds))
    print(
        f"{task}, episodes of {settings.seconds:g} s from seeds {seeds}; {provenance.machine()}\n"
    )
    with file:
        recorded = comparison.record_side_by_side(players, file, settings.seeds, settings.skip)
    summaries = {}
    models = {}
    for policy, of_policy in recorded.scores.items():
        summaries[policy] = summarise(of_policy)
        policy_name = PolicyName.parse(policy, task)
        models[policy] = model_in_the_loop(policy_name)
    table = tables.summary_table("policy", summaries, models)
    print(f"{table}\n\n{comparison.opening_hint(out)}")
