"""One policy on the evaluation episodes, with the arm as the model says and with one that differs from it.

    python agents/evaluate.py POLICY [--task TipPose] [--errors nominal noise ... | all] [--episodes 20] [--out out/evaluate]

POLICY is a controller of the catalogue, or the .zip file of a Stable-Baselines3 agent (ALGORITHM:file.zip, if the file does not say).
Prints a row per model error, and writes every episode as JSON, a picture, and the configuration as resolved.
"""

import argparse
import json
import re
from pathlib import Path
from typing import Any

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt
from _command import MISTAKES, command, said, writable_folder
from _policies import load_policy, short_name
from _records import configuration_record, machine, result_record, write_json
from _runs import Settings, make_env, make_run, print_caveats, scores_of
from _tables import UNITS, full_table
from matplotlib.axis import Axis
from matplotlib.ticker import LogLocator, NullFormatter

from soft_tendon_env.envs import IDS
from soft_tendon_env.evaluation import EpisodeScore, summarise

TARGETS = ("random", "hold", "circle", "ramp")


@command("stopped: nothing is written before the end")
def main() -> None:
    parser = make_parser()
    arguments = parser.parse_args()
    try:
        settings = Settings.parse(given_settings(arguments), "evaluate.py")
        runs = [make_run(settings, arguments.task, arguments.policy, error) for error in settings.errors]
        load_policy(arguments.policy, make_env(runs[0]))  # what is wrong is said before anything takes long
        writable_folder(arguments.out)
        print_caveats(runs)
    except MISTAKES as error:
        parser.error(said(error))
    print(f"{arguments.policy} on {arguments.task}, {settings.episodes} episodes of {settings.seconds:g} s; {machine()}\n")
    scores = {run.error: scores_of(run, progress=True) for run in runs}
    summaries = {error: summarise(of_error) for error, of_error in scores.items()}
    print(full_table("model error", summaries), "\n")
    stem = arguments.out / f"{arguments.task}_{re.sub(r'[^A-Za-z0-9]+', '_', arguments.policy.removesuffix('.zip')).strip('_')}"
    results = [result_record(arguments.policy, error, summaries[error], scores[error]) for error in scores]
    write_json(stem.with_suffix(".json"), {"task": arguments.task, "results": results})
    write_json(stem.with_suffix(".configuration.json"), configuration_record(settings, runs))
    draw(scores, f"{short_name(arguments.policy)} on {arguments.task}", stem.with_suffix(".png"))


def make_parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0], argument_default=argparse.SUPPRESS)
    parser.add_argument("policy", help="a controller's name, or an agent's .zip file")
    parser.add_argument("--task", choices=IDS, default="TipPose")
    add_settings(parser)
    parser.add_argument("--out", type=Path, default=Path("out/evaluate"))
    return parser


def add_settings(parser: argparse.ArgumentParser) -> None:
    """Arguments that every evaluation has."""
    parser.add_argument("--errors", nargs="+", help="names of soft_tendon_env.envs.MODEL_ERRORS, or all (default)")
    parser.add_argument("--episodes", type=int, help="how many of the evaluation seeds, from the first (default: all 20)")
    add_episode(parser)


def add_episode(parser: argparse.ArgumentParser) -> None:
    """Arguments that say what an episode is."""
    parser.add_argument("--target", choices=TARGETS, help="(default: the task's; tables with settings go into --options)")
    parser.add_argument("--seconds", type=float, help="length of an episode (default 10)")
    parser.add_argument("--skip", type=float, help="[s] at the beginning of an episode that errors leave out (default 1)")
    parser.add_argument("--scene", help="a shipped scene's name, or a TOML file")
    parser.add_argument("--fidelity", help="fast, standard or fine (default: as the scene says)")
    parser.add_argument("--options", type=json_object, metavar="JSON", help="more options of the environment, as a JSON object")


def json_object(text: str) -> dict[str, Any]:
    """Raises argparse.ArgumentTypeError."""
    try:
        value = json.loads(text)
    except json.JSONDecodeError as error:
        raise argparse.ArgumentTypeError(f"{text!r} is not JSON: {error}") from error
    if not isinstance(value, dict):
        raise argparse.ArgumentTypeError(f'{text!r} should be a JSON object, such as {{"fidelity": "fast"}}')
    return value


def given_settings(arguments: argparse.Namespace) -> dict[str, Any]:
    """What was given of `add_settings`, as `Settings` takes it. Raises ValueError where an option is given twice."""
    given = vars(arguments)
    own = {key: given[key] for key in ("scene", "fidelity", "target") if key in given}
    if twice := sorted(own.keys() & given.get("options", {}).keys()):
        raise ValueError(f"--options has {', '.join(twice)}, and so has --{twice[0]}: give it once")
    options = {**given.get("options", {}), **own}
    settings = {key: given[key] for key in ("errors", "episodes", "seconds", "skip") if key in given}
    return {**settings, "options": options} if options else settings


def draw(scores: dict[str, list[EpisodeScore]], title: str, path: Path) -> None:
    """Each episode's root mean square error, by model error; crosses are episodes that diverged."""
    names = list(next(iter(scores.values()))[0].errors)
    figure, all_axes = plt.subplots(1, len(names), figsize=(1.0 + 4.5 * len(names), 4.5), constrained_layout=True, squeeze=False)
    for axes, name in zip(all_axes[0], names, strict=True):
        label, scale = UNITS[name]
        for place, of_error in enumerate(scores.values()):
            for marker, colour, diverged in ((".", "#2e6f95", False), ("x", "#d1495b", True)):
                values = [scale * score.errors[name].rms for score in of_error if (score.diverged is not None) == diverged]
                axes.plot([place] * len(values), values, marker, color=colour)
        set_log_scale(axes, axes.yaxis)
        axes.set_xticks(range(len(scores)), list(scores), rotation=40, ha="right")
        axes.set(ylabel=f"{label}, RMS of an episode")
        axes.grid(alpha=0.3, which="both")
    figure.suptitle(title)
    figure.savefig(path, dpi=130)
    plt.close(figure)
    print(f"written: {path}")


def set_log_scale(axes: plt.Axes, axis: Axis) -> None:
    """With labels at 1, 2, 5, 10, ... and room around."""
    axes.set(**{f"{axis.axis_name}scale": "log"})
    axes.margins(0.1)
    axis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
    axis.set_major_formatter("{x:g}")
    axis.set_minor_formatter(NullFormatter())


if __name__ == "__main__":
    main()
