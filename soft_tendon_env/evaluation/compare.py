"""Comparison of policies: controllers and agents on the same episodes, with the arm as their model says and with one that differs from it.

A folder of runs, as `soft-tendon sweep` leaves it, is one policy of several seeds, see seeds.py. Times per action are measured before the
rest, over one episode in a single process with nothing beside it.
"""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path

from tqdm import tqdm

from soft_tendon_env.evaluation import summarise
from soft_tendon_env.evaluation.conditions import NOMINAL
from soft_tendon_env.evaluation.provenance import write_json
from soft_tendon_env.evaluation.settings import EpisodeSettings, Run, all_scores, episode_options, make_env, make_run, scores_of
from soft_tendon_env.evaluation.sweeps import Results, Scores, Summaries
from soft_tendon_env.evaluation.tables import csv_record, episode_records, error_table, full_table, write_csv
from soft_tendon_env.policies.load import load_policy, shared_options


def make_runs(
    settings: EpisodeSettings, task: str, files: Mapping[str, Mapping[int | None, str]], errors: Sequence[str], seeds: tuple[int, ...]
) -> list[Run]:
    """Every agent or controller of every policy with every model error. Raises ValueError, OSError and as policies do.

    All act on the same arm: the one of the settings' options, and where these leave it open the one that the agents were trained on, see
    `shared_options`. Every policy is loaded once, so that what is wrong shows here; ValueError too where policies would not see the same
    episodes.
    """
    each = dict.fromkeys(file for of_policy in files.values() for file in of_policy.values())
    options = shared_options(each, task, settings.options)
    runs = [make_run(settings, seeds, task, file, error, options) for file in each for error in errors]
    reference = episode_options(runs[0].options)
    for run in nominal_of(runs):
        for key, value in episode_options(run.options).items():
            if value != reference[key]:
                text = f"{run.policy} has {key} = {value!r}, {runs[0].policy} has {reference[key]!r}"
                raise ValueError(f"{text}: their episodes would not be the same. Give {key} in options, for all of them")
        load_policy(run.policy, make_env(run))
    return runs


def nominal_of(runs: list[Run]) -> list[Run]:
    """One run per policy, on the arm of the model."""
    return [run._replace(error=NOMINAL) for run in {run.policy: run for run in runs}.values()]


def compare(runs: list[Run], workers: int) -> tuple[Scores, Summaries]:
    """All runs of a task. Times per action come first, over the first episode on the model's arm, so that nothing disturbs them."""
    alone = tqdm(nominal_of(runs), desc=f"{runs[0].task}: time per action", unit="policy", leave=False)
    times = {run.policy: summarise(scores_of(run._replace(seeds=run.seeds[:1]))).action_time for run in alone}
    of_runs = all_scores(runs, workers, f"{runs[0].task}: policies x model errors")
    scores = {(run.policy, run.error): of_run for run, of_run in zip(runs, of_runs, strict=True)}
    return scores, {key: replace(summarise(of_run), action_time=times[key[0]]) for key, of_run in scores.items()}


def tables_of(summaries: Summaries) -> str:
    """Errors by policy and model error; every number on the model's arm, or on the first that there is."""
    errors = [error for _, error in summaries]
    error = NOMINAL if NOMINAL in errors else errors[0]
    full = full_table(f"policy ({error})", {policy: summary for (policy, of), summary in summaries.items() if of == error})
    return f"{error_table(summaries)}\n\n{full}"


def write_task(out: Path, task: str, results: Results, episodes: bool) -> None:
    """Write TASK.json, TASK.csv, TASK.png and, with `episodes`, TASK_episodes.csv into a folder. Raises OSError."""
    from soft_tendon_env.evaluation.pictures import draw_comparison

    summaries = results.all_summaries()
    write_json(out / f"{task}.json", {"task": task, "results": results.records()})
    write_csv(out / f"{task}.csv", [csv_record(policy, error, summary) for (policy, error), summary in summaries.items()])
    draw_comparison(summaries, task, out / f"{task}.png")
    if episodes:
        write_csv(out / f"{task}_episodes.csv", episode_records(results))
