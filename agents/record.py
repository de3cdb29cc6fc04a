"""Policies side by side in one recording: each has an arm, and all live through the same episodes at the same time.

    python agents/record.py POLICY [POLICY ...] [--task TipPose] [--target circle] [--seeds 1000000 ...] [--seconds 10]
                            [--out out/side_by_side.rrd]

POLICY is a controller of the catalogue, measured:NAME, or an agent's .zip file, as for evaluate.py. Prints their errors, and writes a file
for the Rerun viewer, in which the arms have the policies' names.
"""

import argparse
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from _command import MISTAKES, command, said
from _policies import load_policy, short_name
from _records import machine
from _runs import Run, make_env, print_caveats
from _seeds import files_of
from _tables import full_table
from compare import NOMINAL, Comparison, runs_of
from evaluate import add_episode, given_settings
from tqdm import tqdm

from soft_tendon_env import recording
from soft_tendon_env.envs import IDS
from soft_tendon_env.evaluation import EVALUATION_SEEDS, EpisodeScore, evaluate, summarise


@command("stopped: the recording ends with the last whole episode")
def main() -> None:
    parser = make_parser()
    arguments = parser.parse_args()
    try:
        given = {"tasks": [arguments.task], "policies": arguments.policies, "errors": [NOMINAL], **given_settings(arguments)}
        settings = Comparison.parse(given, "record.py")
        files = files_of(arguments.task, settings.policies)
        runs = [run._replace(seeds=tuple(arguments.seeds)) for run in runs_of(settings, arguments.task, files)]
        print_caveats(runs)
        file = recording.RerunFile(arguments.out)
    except MISTAKES as error:
        parser.error(said(error))
    print(f"{arguments.task}, episodes of {settings.seconds:g} s from seeds {', '.join(map(str, arguments.seeds))}; {machine()}\n")
    with file:
        scores = record(runs, file, arm_names([run.policy for run in runs]))
    summaries = {run.policy: summarise(of_run) for run, of_run in zip(runs, scores, strict=True)}
    print(f"{full_table('policy', summaries)}\n\n{how_to_open(arguments.out)}")


def make_parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0], argument_default=argparse.SUPPRESS)
    parser.add_argument("policies", nargs="+", metavar="POLICY", help="a controller's name, or an agent's .zip file")
    parser.add_argument("--task", choices=IDS, default="TipPose")
    parser.add_argument("--seeds", nargs="+", type=seed, default=EVALUATION_SEEDS[:1], help="of the episodes, one after another")
    add_episode(parser)
    parser.add_argument("--out", type=Path, default=Path("out/side_by_side.rrd"))
    return parser


def seed(text: str) -> int:
    """Raises argparse.ArgumentTypeError."""
    if not text.isdecimal():
        raise argparse.ArgumentTypeError(f"{text!r} should be an integer of at least 0")
    return int(text)


def arm_names(policies: Sequence[str]) -> list[str]:
    """Short names, unless two are the same."""
    short = [short_name(policy) for policy in policies]
    return short if len(set(short)) == len(short) else list(policies)


def record(runs: Sequence[Run], file: Any, names: Sequence[str], new: bool = True) -> list[list[EpisodeScore]]:
    """The scores of every run, whose episodes go to the arm of its name in an open RerunFile; `new`: which has none of them yet."""
    players = []
    for run, name in zip(runs, names, strict=True):
        env, place = make_env(run), "beside" if new else None
        players.append((load_policy(run.policy, env), recording.RecordRollout(env, file, flush_period=None, name=name, place=place)))
    scores: list[list[EpisodeScore]] = [[] for _ in runs]
    with tqdm(total=len(runs) * len(runs[0].seeds), desc="side by side", unit="episode", leave=False) as bar:
        for seed in runs[0].seeds:
            file.align()
            for (policy, env), run, of_run in zip(players, runs, scores, strict=True):
                of_run += evaluate(policy, env, [seed], run.skip)
                bar.update()
    return scores


def how_to_open(path: Path) -> str:
    return f"recording: {path}; where there is a screen, `rerun {path}` plays it (`rerun` comes with the extra `recording`)"


if __name__ == "__main__":
    main()
