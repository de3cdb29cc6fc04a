"""Comparison of policies: controllers and agents on the same episodes, with the arm as their model says and with one that differs from it.

A folder of runs is one policy of several seeds, see entrants.py. Errors are those of all episodes, times per action those of a single arm
over the first episode, with nothing beside it.
"""

import sys
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, Literal

from tqdm import tqdm

from soft_tendon_env import recording
from soft_tendon_env.envs import Options
from soft_tendon_env.evaluation.conditions import NOMINAL, model_error
from soft_tendon_env.evaluation.entrants import model_in_the_loop
from soft_tendon_env.evaluation.experiment import Cell, Experiment, Opened
from soft_tendon_env.evaluation.metrics import EpisodeScore
from soft_tendon_env.evaluation.play import evaluate
from soft_tendon_env.evaluation.settings import EpisodeSettings, Settings
from soft_tendon_env.evaluation.summaries import Standing, Standings, Summary, summarise
from soft_tendon_env.evaluation.tables import error_table, summary_table
from soft_tendon_env.policies.agent_files import ARM, is_shipped, shipped_as
from soft_tendon_env.policies.load import short_name
from soft_tendon_env.policies.names import Agent, PolicyName
from soft_tendon_env.tools.configuration import plain, shown

Arms = Mapping[str, dict[str, Any]]
"""Options of every policy's environment, by policy, less model errors."""
TIME = "time per action"
"""Stands in place of a model error where the time per action is measured."""


def shared_arms(settings: EpisodeSettings, task: str, policies: Iterable[str]) -> Arms:
    """Environments in which policies act on the same arm: that of the settings' options, and where these leave it open the one that the
    agents were trained on. Raises ValueError, also where agents differ in that, OSError."""
    parsed = {policy: PolicyName.parse(policy, task) for policy in policies}
    arms = {name: arm for name, policy in parsed.items() if isinstance(policy, Agent) and (arm := policy.arm)}
    first, found = next(iter(arms.items()), ("", {}))
    for name, arm in arms.items():
        for key in ARM:
            if key not in settings.options and arm[key] != found[key]:
                text = f"{name} has {key} = {shown(arm[key])}, {first} has {shown(found[key])}: their episodes would not be the same"
                raise ValueError(f"{text}. Give {key} in options, for all of them, or take them apart")
    usual = Options().model_dump(mode="json")
    given = {**{key: value for key, value in found.items() if value != usual[key]}, **settings.options}
    return {name: policy.options(given) for name, policy in parsed.items()}


def make_cell(settings: EpisodeSettings, seeds: tuple[int, ...], task: str, policy: str, options: dict[str, Any], error: str) -> Cell:
    """A policy under a condition, which overrides what the options have drawn. Raises ValueError."""
    rows = not isinstance(PolicyName.parse(policy, task), Agent)  # a network rounds otherwise for many observations than for one
    return Cell(task, policy, model_error(error).options(options), seeds, settings.seconds, settings.skip, rows=rows)


def alone(cell: Cell) -> Cell:
    """First episode of a cell, with nothing beside it: for times per action, and for recordings."""
    return cell._replace(seeds=cell.seeds[:1], alone=True, rows=False)


def compare(settings: Settings, task: str, arms: Arms, folder: Path) -> Experiment[tuple[str, str]]:
    """Experiment of every policy with every model error, and under TIME alone on the arm of its model. Raises ValueError, OSError for
    policies that cannot act there."""
    cells = dict[tuple[str, str], Cell]()
    for policy, options in arms.items():
        of_policy = {error: make_cell(settings, settings.seeds, task, policy, options, error) for error in (NOMINAL, *settings.errors)}
        cells |= {(policy, TIME): alone(of_policy[NOMINAL]), **{(policy, error): of_policy[error] for error in settings.errors}}
    return Experiment(cells, folder)


def standings_of(experiment: Experiment[tuple[str, str]], files: Mapping[str, Mapping[int | None, str]]) -> Standings:
    """Standings by policy and model error, and TIME; `files` of every policy by seed of training. Raises ValueError, OSError."""
    errors = dict.fromkeys(error for _, error in experiment.cells)
    scores = {key: experiment.scores(key) for key in experiment.cells}
    return {(policy, error): Standing([scores[file, error] for file in of.values()]) for policy, of in files.items() for error in errors}


def summaries_of(found: Standings) -> dict[tuple[str, str], Summary]:
    """Summaries by policy and model error, with the times per action that were measured."""
    times = {policy: summarise(found[policy, error].episodes).action_time for policy, error in found if error == TIME}
    return {key: replace(summarise(own.episodes), action_time=times[key[0]]) for key, own in found.items() if key[1] != TIME}


def models_of(task: str, files: Mapping[str, Mapping[int | None, str]]) -> dict[str, str]:
    """Use of a model at run time, see `model_in_the_loop`, by policy; of several agents the first says it. Raises ValueError, OSError."""
    return {policy: model_in_the_loop(PolicyName.parse(next(iter(of.values())), task)) for policy, of in files.items()}


def comparison_tables(found: Standings, models: Mapping[str, str], every: bool = False) -> str:
    """Errors by policy and model error; below, the usual numbers, or every one, on the model's arm or on the first that there is, and
    `models_of` the policies."""
    summaries = summaries_of(found)
    errors = [error for _, error in summaries]
    error = NOMINAL if NOMINAL in errors else errors[0]
    of_error = {policy: summary for (policy, of), summary in summaries.items() if of == error}
    table = error_table({key: found[key] for key in summaries})
    return f"{table}\n\n{summary_table(f'policy ({error})', of_error, every, models)}"


def results_record(settings: Settings, task: str, arms: Arms, found: Standings) -> dict[str, Any]:
    """All results of a task for JSON: settings, every policy's environment as resolved, summaries and episodes."""
    environments = {policy: Options(**options).model_dump(mode="json") for policy, options in arms.items()}
    results = [
        {
            "policy": policy,
            "model_error": error,
            "summary": summary.record(),
            "episodes": [own.record() for own in found[policy, error].episodes],
        }
        for (policy, error), summary in summaries_of(found).items()
    ]
    return {"task": task, "settings": settings.model_dump(mode="json"), "environments": environments, "results": results}


def print_caveats(settings: EpisodeSettings, arms: Mapping[str, Arms]) -> None:
    """Print what every arm has drawn, whose arm it is, and what trained the agents that ship, on the error stream. Raises ValueError,
    OSError."""
    randomize = settings.options.get("randomize")
    notes = [f"every arm, the nominal one too, has randomize = {shown(plain(randomize))}"] if randomize else []
    for task, of_task in arms.items():
        own = {key: options[key] for options in of_task.values() for key in ARM if key in options and key not in settings.options}
        notes += [f"{task}: on the arm of the agents, {', '.join(f'{key} = {shown(value)}' for key, value in own.items())}"] if own else []
        notes += shipped_notes(of_task, task)
    for note in notes:
        print(f"note: {note}", file=sys.stderr)


def shipped_notes(policies: Iterable[str], task: str) -> list[str]:
    """Lines on those policies that are agents which ship for a task, "agent is dagger (TipPose): DAgger, 144,000 steps". Raises ValueError,
    OSError."""
    return [f"{name} is {shipped_as(name, task)} ({task}): {Agent(name, task).training}" for name in policies if is_shipped(name)]


def arm_names(policies: Sequence[str]) -> list[str]:
    """Short names of policies, unless two are the same."""
    short = [short_name(policy) for policy in policies]
    return short if len(set(short)) == len(short) else list(policies)


def record_side_by_side(
    players: Sequence[Opened], file: Any, names: Sequence[str], seeds: Sequence[int], skip: float, new: bool = True
) -> list[list[EpisodeScore]]:
    """Scores of every policy in its single environment; all play the same episodes, which go to the arm of its name in an open RerunFile.

    skip: errors count from then on [s]. new: the file has no episode of these arms yet.
    """
    place: Literal["beside"] | None = "beside" if new else None
    envs = [
        recording.RecordRollout(env, file, flush_period=None, name=name, place=place) for (_, env), name in zip(players, names, strict=True)
    ]
    scores: list[list[EpisodeScore]] = [[] for _ in players]
    with tqdm(total=len(envs) * len(seeds), desc="side by side", unit="episode", leave=False) as bar:
        for seed in seeds:
            file.align()
            for (policy, _), env, of_arm in zip(players, envs, scores, strict=True):
                of_arm += evaluate(policy, env, [seed], skip)
                bar.update()
    return scores


def opening_hint(path: Path) -> str:
    """Sentence that says how to play a recording."""
    return f"recording: {path}; where there is a screen, `rerun {path}` plays it (`rerun` comes with the extra `recording`)"
