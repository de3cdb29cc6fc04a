"""Comparison of policies: controllers and agents on the same episodes.

They play on the arm as their model says, and on one that differs from it.

A folder of runs is one policy of several seeds, see entrants.py. Times per action are those of a
single arm over the first episode, with nothing beside it.
"""

import sys
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, Literal, NamedTuple

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


def shared_arms(
    settings: EpisodeSettings,
    task: str,
    files: Files,
) -> Arms:
    """Environments in which policies act on the same arm.

    It is that of the settings' options, and where these leave it open the one that the agents were
    trained on, which is printed on the error stream. Raises ValueError, also where agents differ in
    that, OSError.
    """
    policies = dict[str, PolicyName]()
    arms = dict[str, Mapping[str, Any]]()  # of the agents that were trained on one
    for by_seed in files.values():
        for name in by_seed.values():
            policy = PolicyName.parse(name, task)
            policies[name] = policy
            arm = None
            if isinstance(policy, Agent):
                arm = policy.arm
            if arm:
                arms[name] = arm
    shared = _shared_arm(arms, settings.options)
    usual = Options().model_dump(mode="json")
    trained = {key: value for key, value in shared.items() if value != usual[key]}
    if trained:
        numbers = ", ".join(f"{key} = {shown(value)}" for key, value in trained.items())
        note = f"note: {task}: on the arm of the agents, {numbers}"
        print(note, file=sys.stderr)
    options = {**trained, **settings.options}
    return {name: policy.options(options) for name, policy in policies.items()}


def _shared_arm(
    arms: Mapping[str, Mapping[str, Any]], options: Mapping[str, Any]
) -> dict[str, Any]:
    """Options that all of these arms, by agent, have beside the others.

    Raises:
        ValueError: they differ in that.
    """
    if not arms:
        return {}
    pairs = iter(arms.items())
    first, shared = next(pairs)
    for name, arm in arms.items():
        for key in ARM:
            is_of_agents = key not in options
            if is_of_agents and arm[key] != shared[key]:
                raise ValueError(
                    f"{name} has {key} = {shown(arm[key])}, {first} has {shown(shared[key])}: their"
                    f" episodes would not be the same. Give {key} in options, for all of them, or"
                    " take them apart"
                )
    return {key: value for key, value in shared.items() if key not in options}


def make_cell(
    settings: EpisodeSettings,
    seeds: Seeds,
    task: str,
    policy: str,
    options: dict[str, Any],
    error: str = TIME,
) -> Cell:
    """A policy under a condition, which overrides what the options have drawn.

    TIME: its first episode on the arm of the model, with nothing beside it, for times per action
    and for recordings. Raises ValueError.
    """
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
    # a network rounds otherwise for many observations than for one
    name = PolicyName.parse(policy, task)
    rows = not isinstance(name, Agent)
    return Cell(
        task,
        policy,
        model_error(error).options(options),
        seeds,
        settings.seconds,
        settings.skip,
        rows=rows,
    )


def compare(
    settings: Settings,
    task: str,
    arms: Arms,
    folder: Path,
) -> Experiment[tuple[str, str]]:
    """Experiment of every policy with every model error.

    Under TIME each is alone on the arm of its model. Raises ValueError, OSError for policies that
    cannot act there.
    """
    seeds = EVALUATION_SEEDS[: settings.episodes]
    labels = [(policy, TIME) for policy in arms]
    for policy in arms:
        of_policy = [(policy, error) for error in settings.errors]
        labels += of_policy
    cells = dict[tuple[str, str], Cell]()
    for policy, error in labels:
        arm = arms[policy]
        cell = make_cell(settings, seeds, task, policy, arm, error)
        cells[policy, error] = cell
    return Experiment(cells, folder)


def standings_of(
    experiment: Experiment[tuple[str, str]], files: Files
) -> tuple[Standings, Summaries]:
    """Standings by policy and model error; and summaries, with the times per action.

    Raises ValueError, OSError.
    """
    names = (error for _, error in experiment.cells if error != TIME)
    # each once, in their order
    errors = dict.fromkeys(names)
    standings = dict[tuple[str, str], Standing]()
    summaries = dict[tuple[str, str], Summary]()
    for name, by_seed in files.items():
        alone = _standing(experiment, by_seed, TIME)
        time = summarise(alone.episodes).action_time
        for error in errors:
            standing = _standing(experiment, by_seed, error)
            standings[name, error] = standing
            summary = summarise(standing.episodes)
            summaries[name, error] = replace(summary, action_time=time)
    return standings, summaries


def _standing(
    experiment: Experiment[tuple[str, str]], by_seed: Mapping[int | None, str], error: str
) -> Standing:
    """Standing of a policy, with an agent for each seed, under a model error."""
    scores = [experiment.scores((file, error)) for file in by_seed.values()]
    return Standing(scores)


def numbers_table(
    task: str,
    files: Files,
    summaries: Summaries,
) -> str:
    """Table of all numbers, by model error or by policy.

    It has a row per model error of a single policy; of several a row each, on the arm of the model,
    or under the first model error that there is. Raises ValueError, OSError.
    """
    models = dict[str, str]()
    for policy, by_seed in files.items():
        first = next(iter(by_seed.values()))
        name = PolicyName.parse(first, task)
        models[policy] = model_in_the_loop(name)
    names = (error for _, error in summaries)
    errors = list(dict.fromkeys(names))
    if len(files) == 1:
        ((policy, model),) = models.items()
        by_error = {error: summaries[policy, error] for error in errors}
        return summary_table("model error", by_error, dict.fromkeys(errors, model))
    if NOMINAL in errors:
        error = NOMINAL
    else:
        error = errors[0]
    by_policy = {policy: summaries[policy, error] for policy in files}
    return summary_table(f"policy ({error})", by_policy, models)


def results_record(
    settings: Settings,
    task: str,
    arms: Arms,
    standings: Standings,
    summaries: Summaries,
) -> dict[str, Any]:
    """All results of a task for JSON.

    They are settings, every policy's environment as resolved, summaries and episodes.
    """
    environments = {
        policy: Options(**options).model_dump(mode="json") for policy, options in arms.items()
    }
    results = [
        {
            "policy": policy,
            "model_error": error,
            "summary": record(summary),
            "episodes": [*map(record, standings[policy, error].episodes)],
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
    """Records episodes of several policies, each in its single environment.

    All play the same seeds, which go to the arm of the policy's name in an open RerunFile.

    Args:
        players: policies and their environments, by name.
        file: the open RerunFile.
        seeds: of the episodes, at least one.
        skip: errors count from then on [s].
        label: of the progress bar.
        new: the file has no episode of these arms yet.
    """
    place: Literal["beside"] | None = None
    if new:
        place = "beside"
    envs = {
        name: recording.RecordRollout(env, file, flush_period=None, name=name, place=place)
        for name, (_, env) in players.items()
    }
    scores: dict[str, list[EpisodeScore]] = {name: [] for name in players}
    with progress_bar(len(seeds) * len(players), label, "episode") as bar:
        for seed in seeds:
            file.align()
            for name, (policy, _) in players.items():
                env = envs[name]
                scores[name] += evaluate(policy, env, [seed], skip)
                bar.update()
    rollouts = {name: env.rollout for name, env in envs.items() if env.rollout is not None}
    return SideBySide(scores, rollouts)


def opening_hint(path: Path) -> str:
    """Sentence that says how to play a recording."""
    return (
        f"recording: {path}; where there is a screen, `rerun {path}` plays it (`rerun` comes with"
        " the extra `recording`)"
    )
