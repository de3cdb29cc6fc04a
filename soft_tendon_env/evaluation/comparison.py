"""Comparison of policies: controllers and agents on the same episodes, with the arm as their model says and with one that differs from it.

A folder of runs, as `soft-tendon sweep` leaves it, is one policy of several seeds, see entrants.py. Errors are those of all episodes, times
per action those of a single arm over the first episode, with nothing beside it.
"""

import sys
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, Literal, NamedTuple

from tqdm import tqdm

from soft_tendon_env import recording
from soft_tendon_env.envs import Options
from soft_tendon_env.evaluation.conditions import NOMINAL, model_error
from soft_tendon_env.evaluation.entrants import model_in_the_loop
from soft_tendon_env.evaluation.experiment import Cell, Experiment, Opened
from soft_tendon_env.evaluation.metrics import EpisodeScore
from soft_tendon_env.evaluation.play import evaluate
from soft_tendon_env.evaluation.provenance import origin
from soft_tendon_env.evaluation.settings import EpisodeSettings, Settings
from soft_tendon_env.evaluation.summaries import Summary, over_seeds, summarise
from soft_tendon_env.evaluation.tables import episode_record, error_table, summary_table
from soft_tendon_env.policies.agent_checks import caveats
from soft_tendon_env.policies.agent_files import ARM, is_agent
from soft_tendon_env.policies.load import policy_options, shared_options, short_name
from soft_tendon_env.policies.names import PolicyName
from soft_tendon_env.policies.trained_by import shipped_notes
from soft_tendon_env.tools.configuration import plain, shown

Arms = Mapping[str, dict[str, Any]]
"""Options of every policy's environment, by policy, less model errors."""


def shared_arms(settings: EpisodeSettings, task: str, policies: Iterable[str]) -> Arms:
    """Environments in which policies act on the same arm: the one of the settings' options, and where these leave it open the one that the
    agents were trained on, see `shared_options`. Raises ValueError, also where they would not see the same episodes, OSError."""
    policies = [*policies]
    given = shared_options(policies, task, settings.options)
    return {policy: policy_options(policy, task, given) for policy in policies}


def make_cell(settings: EpisodeSettings, seeds: tuple[int, ...], task: str, policy: str, options: dict[str, Any], error: str) -> Cell:
    """A policy on an arm with a model error, which overrides what the options have drawn. Raises ValueError."""
    randomize = {**plain(options.get("randomize", {})), **model_error(error)}
    rows = not is_agent(policy)  # a network rounds otherwise for many observations than for one
    return Cell(task, policy, {**options, "randomize": randomize}, seeds, settings.seconds, settings.skip, rows=rows)


def alone(cell: Cell) -> Cell:
    """First episode of a cell, with nothing beside it: for times per action, and for recordings."""
    return cell._replace(seeds=cell.seeds[:1], measured="time", rows=False)


def compare(settings: Settings, task: str, arms: Arms, folder: Path) -> Experiment[tuple[str, str]]:
    """Experiment of every policy with every model error, and under TIME alone on the arm of its model. Raises ValueError, OSError for
    policies that cannot act there: each is loaded once."""
    cells = {}
    for policy, options in arms.items():
        of_policy = {error: make_cell(settings, settings.seeds, task, policy, options, error) for error in (NOMINAL, *settings.errors)}
        cells[policy, TIME] = alone(of_policy[NOMINAL])
        cells |= {(policy, error): of_policy[error] for error in settings.errors}
    experiment = Experiment(cells, folder)
    experiment.open_alone()
    return experiment


TIME = "time per action"
"""Stands in place of a model error where the time per action is measured."""


class Outcome(NamedTuple):
    """A policy with a model error: files, scores and summaries of its agents, by seed of training; a controller's file is its name, and
    None the seed of what is no folder of seeds."""

    files: Mapping[int | None, str]
    scores: Mapping[int | None, list[EpisodeScore]]
    summaries: Mapping[int | None, Summary]

    @property
    def summary(self) -> Summary:
        """Summary of the policy, over all its seeds."""
        return self.summaries[None] if None in self.files else over_seeds([*self.summaries.values()], [*self.scores.values()])

    def record(self, policy: str, error: str) -> dict[str, Any]:
        """The policy's results for JSON; those of a folder have a record per seed."""

        def record(name: str, summary: Summary) -> dict[str, Any]:
            return {"policy": name, "model_error": error, "summary": summary.record()}

        def whole(seed: int | None) -> dict[str, Any]:
            scores = [score.record() for score in self.scores[seed]]
            episodes = [{key: value for key, value in score.items() if key != "action_time"} for score in scores]  # rows, side by side
            return {**record(self.files[seed], self.summaries[seed]), "episodes": episodes}

        if None in self.files:
            return whole(None)
        return {**record(policy, self.summary), "seeds": [{"seed": seed, **whole(seed)} for seed in self.files]}


Outcomes = Mapping[tuple[str, str], Outcome]
"""Outcomes by policy and model error."""


def outcomes_of(experiment: Experiment[tuple[str, str]], files: Mapping[str, Mapping[int | None, str]]) -> Outcomes:
    """Outcomes of a comparison that was played; `files` of every policy by seed of training. Raises ValueError, OSError."""

    def outcome(of: Mapping[int | None, str], error: str) -> Outcome:
        scores = {seed: experiment.scores((file, error)) for seed, file in of.items()}
        times = {seed: summarise(experiment.scores((file, TIME))).action_time for seed, file in of.items()}
        return Outcome(of, scores, {seed: replace(summarise(scores[seed]), action_time=times[seed]) for seed in of})

    errors = dict.fromkeys(error for _, error in experiment.cells if error != TIME)
    return {(policy, error): outcome(of, error) for policy, of in files.items() for error in errors}


def episode_records(outcomes: Outcomes) -> list[dict[str, Any]]:
    """Every episode in few numbers, for CSV."""
    return [
        {"policy": policy, "training_seed": seed, "model_error": error, **episode_record(score)}
        for (policy, error), outcome in outcomes.items()
        for seed, scores in outcome.scores.items()
        for score in scores
    ]


def models_of(task: str, files: Mapping[str, Mapping[int | None, str]]) -> dict[str, str]:
    """Use of a model at run time, see `model_in_the_loop`, by policy; of several agents the first says it. Raises ValueError, OSError."""
    return {policy: model_in_the_loop(PolicyName.parse(next(iter(of.values())), task)) for policy, of in files.items()}


def comparison_tables(summaries: Mapping[tuple[str, str], Summary], models: Mapping[str, str], every: bool = False) -> str:
    """Errors by policy and model error; below, the usual numbers, or every one, on the model's arm or on the first that there is, and
    `models_of` the policies."""
    errors = [error for _, error in summaries]
    error = NOMINAL if NOMINAL in errors else errors[0]
    of_error = {policy: summary for (policy, of), summary in summaries.items() if of == error}
    return f"{error_table(summaries)}\n\n{summary_table(f'policy ({error})', of_error, every, models)}"


def configuration_record(settings: Settings, arms: Mapping[str, Arms]) -> dict[str, Any]:
    """All that results depend on, for JSON: settings, every policy's environment as resolved, by task, model errors, versions, machine."""
    return {
        **origin(),
        "settings": settings.model_dump(mode="json"),
        "seeds": settings.seeds,
        "model_errors": {name: model_error(name) for name in settings.errors},
        "environments": [
            {"task": task, "policy": policy, "options": Options(**options).model_dump(mode="json")}
            for task, of_task in arms.items()
            for policy, options in of_task.items()
        ],
    }


def print_caveats(settings: EpisodeSettings, arms: Mapping[str, Arms]) -> None:
    """Print what should be known of the arm and of the agents among policies, by task, on the error stream. Raises ValueError, OSError."""
    randomize = settings.options.get("randomize")
    notes = [f"every arm, the nominal one too, has randomize = {shown(plain(randomize))}"] if randomize else []
    borrowed: dict[str, dict[str, None]] = {}
    judged = []
    for task, of_task in arms.items():
        notes += [f"{line} ({task})" for line in shipped_notes(of_task, task)]
        for policy, options in of_task.items():
            own = [f"{key} = {shown(options[key])}" for key in ARM if key in options and key not in settings.options]
            if is_agent(policy):
                judged.append((policy, task, options))
                notes += [f"{policy}: {line}, from its training" for line in own if not line.startswith(("scene", "fidelity"))]
            elif own:
                borrowed.setdefault(", ".join(own), {})[policy] = None
    notes += [f"{', '.join(names)}: on the arm of the agents beside, {arm}" for arm, names in borrowed.items()]
    for note in [*notes, *caveats(judged)]:
        print(f"note: {note}", file=sys.stderr)


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
    arms = [
        (policy, recording.RecordRollout(env, file, flush_period=None, name=name, place=place))
        for (policy, env), name in zip(players, names, strict=True)
    ]
    scores: list[list[EpisodeScore]] = [[] for _ in arms]
    with tqdm(total=len(arms) * len(seeds), desc="side by side", unit="episode", leave=False) as bar:
        for seed in seeds:
            file.align()
            for (policy, env), of_arm in zip(arms, scores, strict=True):
                of_arm += evaluate(policy, env, [seed], skip)
                bar.update()
    return scores


def opening_hint(path: Path) -> str:
    """Sentence that says how to play a recording."""
    return f"recording: {path}; where there is a screen, `rerun {path}` plays it (`rerun` comes with the extra `recording`)"
