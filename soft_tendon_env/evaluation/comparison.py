"""Comparison of policies: controllers and agents on the same episodes, with the arm as their model
says and with one that differs from it.

A folder of runs is one policy of several seeds, see entrants.py. Times per action are those of a
single arm over the first episode, with nothing beside it.
"""

import sys
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

from soft_tendon_env import recording
from soft_tendon_env.envs import Options
from soft_tendon_env.evaluation.conditions import EVALUATION_SEEDS, NOMINAL, model_error
from soft_tendon_env.evaluation.entrants import model_in_the_loop
from soft_tendon_env.evaluation.experiment import Cell, Experiment
from soft_tendon_env.evaluation.metrics import EpisodeScore, record
from soft_tendon_env.evaluation.play import evaluate
from soft_tendon_env.evaluation.settings import EpisodeSettings, Seeds, Settings
from soft_tendon_env.evaluation.summaries import Standing, Standings, Summary, summarise
from soft_tendon_env.evaluation.tables import summary_table
from soft_tendon_env.policies.agent import ARM
from soft_tendon_env.policies.names import Agent, PolicyName
from soft_tendon_env.policies.protocol import Policy
from soft_tendon_env.tools.configuration import shown
from soft_tendon_env.tools.progress import progress_bar

Arms = Mapping[str, dict[str, Any]]
"""Options of every policy's environment, by policy, less model errors."""
Files = Mapping[str, Mapping[int | None, str]]
"""Policies of every name by seed of training, see `entrants.agents_of`."""
Summaries = Mapping[tuple[str, str], Summary]
"""Summaries by policy and model error."""
TIME = "time per action"
"""Stands in place of a model error where the time per action is measured."""


def shared_arms(settings: EpisodeSettings, task: str, files: Files) -> Arms:
    """Environments in which policies act on the same arm: that of the settings' options, and where
    these leave it open the one that the agents were trained on, which is printed on the error
    stream. Raises ValueError, also where agents differ in that, OSError."""
    parsed = {
        policy: PolicyName.parse(policy, task) for of in files.values() for policy in of.values()
    }
    arms = {
        name: arm
        for name, policy in parsed.items()
        if isinstance(policy, Agent) and (arm := policy.arm)
    }
    first, found = next(iter(arms.items()), ("", {}))
    for name, arm in arms.items():
        for key in ARM:
            if key not in settings.options and arm[key] != found[key]:
                text = (
                    f"{name} has {key} = {shown(arm[key])}, {first} has {shown(found[key])}: their"
                    " episodes would not be the same"
                )
                raise ValueError(
                    f"{text}. Give {key} in options, for all of them, or take them apart"
                )
    usual = Options().model_dump(mode="json")
    trained = {
        key: value
        for key, value in found.items()
        if value != usual[key] and key not in settings.options
    }
    if trained:
        print(
            f"note: {task}: on the arm of the agents,"
            f" {', '.join(f'{key} = {shown(trained[key])}' for key in trained)}",
            file=sys.stderr,
        )
    return {
        name: policy.options({**trained, **settings.options}) for name, policy in parsed.items()
    }


def make_cell(
    settings: EpisodeSettings,
    seeds: Seeds,
    task: str,
    policy: str,
    options: dict[str, Any],
    error: str = TIME,
) -> Cell:
    """A policy under a condition, which overrides what the options have drawn. TIME: its first
    episode on the arm of the model, with nothing beside it, for times per action and for
    recordings. Raises ValueError."""
    if error == TIME:
        return Cell(
            task,
            policy,
            model_error(NOMINAL).options(options),
            seeds[:1],
            settings.seconds,
            settings.skip,
            alone=True,
            rows=False,
        )
    rows = not isinstance(
        PolicyName.parse(policy, task), Agent
    )  # a network rounds otherwise for many observations than for one
    return Cell(
        task,
        policy,
        model_error(error).options(options),
        seeds,
        settings.seconds,
        settings.skip,
        rows=rows,
    )


def compare(settings: Settings, task: str, arms: Arms, folder: Path) -> Experiment[tuple[str, str]]:
    """Experiment of every policy with every model error, and under TIME alone on the arm of its
    model. Raises ValueError, OSError for policies that cannot act there."""
    seeds = EVALUATION_SEEDS[: settings.episodes]
    labels = [(policy, TIME) for policy in arms] + [
        (policy, error) for policy in arms for error in settings.errors
    ]
    return Experiment(
        {
            (policy, of): make_cell(settings, seeds, task, policy, arms[policy], of)
            for policy, of in labels
        },
        folder,
    )


def standings_of(
    experiment: Experiment[tuple[str, str]], files: Files
) -> tuple[Standings, Summaries]:
    """Standings by policy and model error; and summaries, with the times per action. Raises
    ValueError, OSError."""
    errors = dict.fromkeys(error for _, error in experiment.cells)
    of_all = {
        (name, error): Standing([experiment.scores((file, error)) for file in of.values()])
        for name, of in files.items()
        for error in errors
    }
    found = {key: standing for key, standing in of_all.items() if key[1] != TIME}
    times = {name: summarise(of_all[name, TIME].episodes).action_time for name in files}
    return found, {
        key: replace(summarise(standing.episodes), action_time=times[key[0]])
        for key, standing in found.items()
    }


def numbers_table(task: str, files: Files, summaries: Summaries) -> str:
    """Table of all numbers: a row per model error of a single policy; of several a row each, on the
    arm of the model, or under the first model error that there is. Raises ValueError, OSError."""
    models = {
        policy: model_in_the_loop(PolicyName.parse(next(iter(of.values())), task))
        for policy, of in files.items()
    }
    errors = [*dict.fromkeys(error for _, error in summaries)]
    if len(files) == 1:
        ((policy, model),) = models.items()
        return summary_table(
            "model error",
            {error: summaries[policy, error] for error in errors},
            dict.fromkeys(errors, model),
        )
    error = NOMINAL if NOMINAL in errors else errors[0]
    of_error = {policy: summaries[policy, error] for policy in files}
    return summary_table(f"policy ({error})", of_error, models)


def results_record(
    settings: Settings, task: str, arms: Arms, found: Standings, summaries: Summaries
) -> dict[str, Any]:
    """All results of a task for JSON: settings, every policy's environment as resolved, summaries
    and episodes."""
    environments = {
        policy: Options(**options).model_dump(mode="json") for policy, options in arms.items()
    }
    results = [
        {
            "policy": policy,
            "model_error": error,
            "summary": record(summary),
            "episodes": [*map(record, found[policy, error].episodes)],
        }
        for (policy, error), summary in summaries.items()
    ]
    return {
        "task": task,
        "settings": settings.model_dump(mode="json"),
        "environments": environments,
        "results": results,
    }


class SideBySide(NamedTuple):
    """Recorded policies, by name: scores of all their episodes, and the last episode of each."""

    scores: dict[str, list[EpisodeScore]]
    rollouts: dict[str, recording.Rollout]


def record_side_by_side(
    players: Mapping[str, tuple[Policy, Any]],
    file: Any,
    seeds: Sequence[int],
    skip: float,
    label: str = "recording",
    new: bool = True,
) -> SideBySide:
    """Episodes of several policies, each in its single environment; all play the same seeds, which
    go to the arm of the policy's name in an open RerunFile.

    Args:
        players: policies and their environments, by name.
        file: the open RerunFile.
        seeds: of the episodes, at least one.
        skip: errors count from then on [s].
        label: of the progress bar.
        new: the file has no episode of these arms yet.
    """
    envs = {
        name: recording.RecordRollout(
            env, file, flush_period=None, name=name, place="beside" if new else None
        )
        for name, (_, env) in players.items()
    }
    scores: dict[str, list[EpisodeScore]] = {name: [] for name in players}
    with progress_bar(len(seeds) * len(players), label, "episode") as bar:
        for seed in seeds:
            file.align()
            for name, (policy, _) in players.items():
                scores[name] += evaluate(policy, envs[name], [seed], skip)
                bar.update()
    rollouts = {name: env.rollout for name, env in envs.items() if env.rollout is not None}
    return SideBySide(scores, rollouts)


def opening_hint(path: Path) -> str:
    """Sentence that says how to play a recording."""
    return (
        f"recording: {path}; where there is a screen, `rerun {path}` plays it (`rerun` comes with"
        " the extra `recording`)"
    )
