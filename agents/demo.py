"""The demo: the paper's controller, model-based controllers and the shipped agent on the paper's arm, on its circle and on random targets.

    python agents/demo.py [--agent agents/trained/TipPose/model.zip] [--episodes 20] [--seconds 10] [--workers 2]
                          [--write-docs FILE] [--out out]

Prints their errors, and writes a picture, OUT/demo.png, and a recording for the Rerun viewer, OUT/demo.rrd: all arms side by side, first
along the circle, then along one of the random targets. Errors count from a tenth of an episode on. Times per action are those of the
recorded episodes, which are lived through in one process with nothing beside it.
"""

import argparse
import os
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from _agents import agent_file, algorithm_of, is_agent
from _command import MISTAKES, command, said, writable_folder
from _demo_picture import draw
from _records import machine
from _runs import Run, all_scores
from _seeds import files_of
from _tables import around_markers, full_table, write_between_markers
from compare import NOMINAL, Comparison, runs_of
from record import how_to_open, record

from soft_tendon_env import recording
from soft_tendon_env.control import CONTROLLERS
from soft_tendon_env.evaluation import EVALUATION_SEEDS, EpisodeScore, Summary, summarise
from soft_tendon_env.recording import Rollout

TASK = "TipPose"
AGENT = Path(__file__).parent / "trained" / TASK / "model.zip"
SHOWN = ("paper", "tracking", "predictive")
ARM = {"fidelity": "standard"}
SKIPPED = 0.1  # of an episode
MARKER = "demo"
LEFT_OUT = ("effort [N]", "rate [N/s]", "return")
NOTES = """The tendons of this arm pull, with 0 to 60 N, and cannot push. At rest they can hold the tip only a few millimetres off the
poses of the circle, and about as much is left of the errors there; random targets are poses that the arm can hold. (39) is
continuous in time and takes tendons that push as well: as printed, held for 20 ms and cut off at 0 N, it is unstable. `tracking` is
the same law made usable; `python agents/reproduce_paper.py` shows it as the paper has it."""


class Kept:
    """An open RerunFile of which every episode is kept as well: rollouts, by arm."""

    def __init__(self, file: Any) -> None:
        self._file, self.rollouts = file, {}
        self.path, self.add_arm, self.align = file.path, file.add_arm, file.align

    def write(self, rollout: Rollout, arm: str, *, continues: bool) -> None:
        self._file.write(rollout, arm, continues=continues)
        self.rollouts.setdefault(arm, []).append(rollout)


@command("stopped")
def main() -> None:
    parser = make_parser()
    arguments = parser.parse_args()
    try:
        circle, random = (runs_on(target, arguments) for target in ("circle", "random"))
        if arguments.write_docs:
            around_markers(arguments.write_docs, MARKER)
        file = recording.RerunFile(writable_folder(arguments.out) / "demo.rrd")
    except MISTAKES as error:
        parser.error(said(error))
    names = [name_of(run.policy) for run in circle]
    print("\n".join(f"{name:<10} {description(run.policy)}" for name, run in zip(names, circle, strict=True)), "\n")
    with file:
        kept = Kept(file)
        on_circle, first = record(first_of(circle), kept, names), record(first_of(random), kept, names, new=False)
    on_random = every_score(random, arguments.workers)
    tables = tables_of(
        {name: summarise(scores) for name, scores in zip(names, on_circle, strict=True)},
        {name: timed(scores, alone) for name, scores, alone in zip(names, on_random, first, strict=True)},
    )
    print(f"{tables}\n\n{NOTES}\n")
    draw({name: kept.rollouts[name][0] for name in names}, dict(zip(names, on_random, strict=True)), arguments.out / "demo.png")
    if arguments.write_docs:
        what = f"`python agents/demo.py --write-docs`: episodes of {arguments.seconds:g} s, on {machine()}"
        write_between_markers(arguments.write_docs, MARKER, f"Written by {what}.\n\n{tables}\n\n{NOTES}")
    print(how_to_open(arguments.out / "demo.rrd"))


def make_parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--agent", default=str(AGENT), metavar="FILE", help="an agent's .zip file (default: the one that is shipped)")
    most = len(EVALUATION_SEEDS)
    parser.add_argument("--episodes", type=int, default=most, help=f"random targets, at most {most}, which is the default")
    parser.add_argument("--seconds", type=float, default=10.0, help="length of an episode (default 10)")
    parser.add_argument("--workers", type=int, default=2, help="processes (default 2)")
    text = f"tables also go between its <!-- {MARKER} --> and <!-- /{MARKER} -->"
    parser.add_argument("--write-docs", type=Path, metavar="FILE", help=text)
    parser.add_argument("--out", type=Path, default=Path("out"), help="folder of the picture and the recording")
    return parser


def runs_on(target: str, arguments: argparse.Namespace) -> list[Run]:
    """Every policy on a target. Raises as `runs_of`, and where the agent is none."""
    if not is_agent(arguments.agent):
        raise ValueError(f"--agent is {arguments.agent}: it should be the .zip file of an agent")
    given = {
        "tasks": [TASK],
        "policies": [*SHOWN, arguments.agent],
        "errors": [NOMINAL],
        "episodes": arguments.episodes,
        "seconds": arguments.seconds,
        "skip": SKIPPED * arguments.seconds,
        "options": {**ARM, "target": target},
        "workers": arguments.workers,
    }
    settings = Comparison.parse(given, "demo.py")
    return runs_of(settings, TASK, files_of(TASK, settings.policies))


def first_of(runs: Sequence[Run]) -> list[Run]:
    """The runs with their first episode alone."""
    return [run._replace(seeds=run.seeds[:1]) for run in runs]


def name_of(policy: str) -> str:
    return "agent" if is_agent(policy) else policy


def description(policy: str) -> str:
    if not is_agent(policy):
        return CONTROLLERS[TASK][policy].description
    algorithm, path = agent_file(policy)
    return f"trained with {algorithm or algorithm_of(path)}: {os.path.relpath(path)}"


def every_score(runs: Sequence[Run], workers: int) -> list[list[EpisodeScore]]:
    """Scores of every run; each episode is a piece of work of its own."""
    pieces = [run._replace(seeds=(seed,)) for run in runs for seed in run.seeds]
    scores = iter(all_scores(pieces, workers, "random targets: policies x episodes"))
    return [[score for _ in run.seeds for score in next(scores)] for run in runs]


def timed(scores: Sequence[EpisodeScore], alone: Sequence[EpisodeScore]) -> Summary:
    """Scores together, with the times per action of an episode that had the machine for itself."""
    return replace(summarise(scores), action_time=summarise(alone).action_time)


def tables_of(on_circle: dict[str, Summary], on_random: dict[str, Summary]) -> str:
    episodes = next(iter(on_random.values())).episodes
    return f"{full_table('circle', on_circle, LEFT_OUT)}\n\n{full_table(f'{episodes} random targets', on_random, LEFT_OUT)}"


if __name__ == "__main__":
    main()
