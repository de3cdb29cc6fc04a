"""Controllers and agents on the same episodes, with the arm as their model says and with one that differs from it.

    python agents/compare.py [--task TipPose Shape Reach] [--policies all runs/ppo/model.zip] [--errors nominal noise ... | all]
                             [--episodes 20] [--workers 2] [--config configs/compare.toml] [--write-docs FILE] [--out out/compare]

"all" policies are the controllers of the catalogue; a folder of runs, as sweep.py leaves it, is one policy of several seeds, see
_seeds.py. Arguments go before what a config file says. Prints, per task, errors by policy and model error, and every number under the
nominal model; writes JSON with every episode, CSV, a picture, the configuration as resolved and, with `episode_csv`, a row per episode.
Times per action are measured before the rest, over one episode in a single process with nothing beside it.
"""

import argparse
from dataclasses import replace
from pathlib import Path
from typing import Any, Literal

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt
from _command import MISTAKES, command, said, writable_folder
from _labels import Point, write_names
from _policies import ALL, load_policy, short_name
from _records import configuration_record, machine, write_json
from _runs import Run, Settings, all_scores, episode_options, make_env, make_run, print_caveats, scores_of
from _seeds import Results, Scores, SeedSummary, Summaries, files_of
from _tables import UNITS, around_markers, csv_record, episode_records, error_table, full_table, write_between_markers, write_csv
from evaluate import add_settings, given_settings, set_log_scale
from pydantic import Field
from tqdm import tqdm

from soft_tendon_env.envs import IDS
from soft_tendon_env.evaluation import MODEL_ERRORS, Summary, summarise
from soft_tendon_env.tools.configuration import read_toml

NOMINAL = next(iter(MODEL_ERRORS))


class Comparison(Settings):
    """The keys of a config file: those of `Settings`, and

    tasks; policies: names of controllers, "all" of them, files of agents, or folders of runs; workers: processes; episode_csv: whether
    to write TASK_episodes.csv, every episode in few numbers.
    """

    tasks: tuple[Literal["TipPose", "Shape", "Reach"], ...] = Field(default=tuple(IDS), min_length=1)
    policies: tuple[str, ...] = Field(default=(ALL,), min_length=1)
    workers: int = Field(default=2, ge=1)
    episode_csv: bool = False


@command("stopped: the tasks that were through are written")
def main() -> None:
    parser = make_parser()
    arguments = parser.parse_args()
    try:
        settings = read_settings(arguments)
        files = {task: files_of(task, settings.policies) for task in settings.tasks}
        runs = {task: runs_of(settings, task, files[task]) for task in settings.tasks}
        if arguments.write_docs:
            for task in settings.tasks:
                around_markers(arguments.write_docs, marker(task))
        writable_folder(arguments.out)
        print_caveats([run for of_task in runs.values() for run in of_task])
    except MISTAKES as error:
        parser.error(said(error))
    print(f"{settings.episodes} episodes of {settings.seconds:g} s; {machine()}")
    write_json(arguments.out / "configuration.json", configuration_record(settings, [run for of_task in runs.values() for run in of_task]))
    for task in settings.tasks:
        results = Results(files[task], *compare(runs[task], settings.workers))
        tables = tables_of(results.shown())
        print(f"\n## {task}\n\n{tables}\n")
        write_task(arguments.out, task, results)
        if settings.episode_csv:
            write_csv(arguments.out / f"{task}_episodes.csv", episode_records(results))
        if arguments.write_docs:
            what = f"{settings.episodes} episodes of {settings.seconds:g} s, on {machine()}"
            text = f"Written by `python agents/compare.py --write-docs`: {what}.\n\n{tables}"
            write_between_markers(arguments.write_docs, marker(task), text)


def marker(task: str) -> str:
    return f"compare {task}"


def make_parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0], argument_default=argparse.SUPPRESS)
    parser.add_argument("--task", dest="tasks", nargs="+", choices=IDS, help="(default: all)")
    parser.add_argument("--policies", nargs="+", help="controllers, all of them, agents' .zip files, or folders of runs (default: all)")
    add_settings(parser)
    parser.add_argument("--workers", type=int, help="processes (default 2)")
    parser.add_argument("--episode-csv", action="store_true", help="write TASK_episodes.csv too, a row per episode")
    parser.add_argument("--config", type=Path, default=None, help="a TOML file with the keys of Comparison")
    parser.add_argument(
        "--write-docs",
        type=Path,
        default=None,
        metavar="FILE",
        help="tables also go between its <!-- compare TASK --> and <!-- /compare TASK -->",
    )
    parser.add_argument("--out", type=Path, default=Path("out/compare"))
    return parser


def read_settings(arguments: argparse.Namespace) -> Comparison:
    """The config file's, with what was given before it. Raises ConfigurationError."""
    table: dict[str, Any] = {}
    if arguments.config is not None:
        table = read_toml(arguments.config)
        Comparison.parse(table, str(arguments.config))
    given = given_settings(arguments)
    given |= {key: getattr(arguments, key) for key in ("tasks", "policies", "workers", "episode_csv") if hasattr(arguments, key)}
    if "options" in given:
        given["options"] = {**table.get("options", {}), **given["options"]}
    return Comparison.parse({**table, **given}, "compare.py")


def runs_of(settings: Comparison, task: str, files: dict[str, dict[int | None, str]]) -> list[Run]:
    """Every file of every policy with every model error. What is wrong is said here. Raises ValueError, OSError and as policies do."""
    each = dict.fromkeys(file for of_policy in files.values() for file in of_policy.values())
    runs = [make_run(settings, task, file, error) for file in each for error in settings.errors]
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


def write_task(out: Path, task: str, results: Results) -> None:
    summaries = results.shown()
    write_json(out / f"{task}.json", {"task": task, "results": results.records()})
    write_csv(out / f"{task}.csv", [csv_record(policy, error, summary) for (policy, error), summary in summaries.items()])
    draw(summaries, task, out / f"{task}.png")


def draw(summaries: Summaries, task: str, path: Path) -> None:
    """Errors by model error, and against time per action; hollow where episodes diverged, with a bar where there are several seeds."""
    figure, (left, right) = plt.subplots(1, 2, figsize=(13, 5), dpi=130, constrained_layout=True, width_ratios=(1.6, 1))
    policies, errors = (list(dict.fromkeys(key[i] for key in summaries)) for i in (0, 1))
    name = next(iter(next(iter(summaries.values())).errors))
    label, scale = UNITS[name]
    colours, points = plt.get_cmap("tab20").colors, []
    for index, policy in enumerate(policies):
        colour, of_policy = colours[index % len(colours)], [summaries[policy, error] for error in errors]
        values = [scale * summary.errors[name].rms for summary in of_policy]
        left.plot(values, color=colour, alpha=0.4)
        for place, (summary, value) in enumerate(zip(of_policy, values, strict=True)):
            face = "none" if summary.flagged else colour
            left.plot(place, value, "o", color=colour, markerfacecolor=face, label=short_name(policy) if place == 0 else None)
            left.vlines(place, *bounds_of(summary, name, scale), color=colour)
        time = 1e3 * of_policy[0].action_time.median
        right.plot(time, values[0], "o", color=colour, markerfacecolor="none" if of_policy[0].flagged else colour)
        right.vlines(time, *bounds_of(of_policy[0], name, scale), color=colour)
        points.append(Point(time, values[0], short_name(policy)))
    left.set_xticks(range(len(errors)), errors, rotation=40, ha="right")
    left.legend(frameon=False, fontsize=8, ncols=2)
    left.set(ylabel=f"{label}, RMS", title=f"{task} by model error")
    right.set(xlabel="time per action [ms], median", ylabel=f"{label}, RMS", title=errors[0])
    for axes, axis in ((left, left.yaxis), (right, right.yaxis), (right, right.xaxis)):
        set_log_scale(axes, axis)
        axes.grid(alpha=0.3, which="both")
    write_names(right, [point for point in points if point.y > 0.0])
    figure.savefig(path, dpi=figure.dpi)
    plt.close(figure)
    print(f"written: {path}")


def bounds_of(summary: Summary, name: str, scale: float) -> tuple[float, float]:
    """Of the interval of an error's RMS; the number itself, twice, where there is one seed."""
    number = summary.errors[name].rms
    low, high = summary.intervals[f"{name}_rms"] if isinstance(summary, SeedSummary) else (number, number)
    return scale * low, scale * high


if __name__ == "__main__":
    main()
