"""Errors of agents for arms of one's own, trained in ten minutes each: a table and a CSV file.

    python benchmarks/own_agents.py [--arms three_tendon ...] [--steps 1000000] [--episodes 48]
    [--quick] [--out out]

Each arm gets an agent by `configs/apg_tip_pose.toml`, whose numbers are shares of the arm. The
agent then plays the first targets of its training: on the arm as it is, and with one cause of
errors at a time that the training draws. Errors are root mean squares of the tip's position from
`evaluation.skip` on, as shares of the rod's length. An arm with few tendons cannot hold a pose
under a load.
"""

import time
from collections.abc import Mapping
from contextlib import closing
from pathlib import Path
from typing import Any

import gymnasium as gym
import tomli_w
from _results import markdown_table, parser_of, write_csv, write_tables
from own_arms import ARMS

from soft_tendon_env.envs import IDS
from soft_tendon_env.evaluation.conditions import SEEDS
from soft_tendon_env.evaluation.metrics import EpisodeScore
from soft_tendon_env.evaluation.play import evaluate_rows
from soft_tendon_env.evaluation.settings import episode_steps
from soft_tendon_env.evaluation.summaries import interquartile_mean
from soft_tendon_env.learning.config import Training, find_config, read_training
from soft_tendon_env.learning.train import train
from soft_tendon_env.policies import load_policy
from soft_tendon_env.scene.file import scene_names

TASK = "TipPose"
CONFIG = "apg_tip_pose"
OWN = ("stocky, force at the tip", "sags", "two materials", "payload")
"""Arms of own_arms.py that do not ship."""
CAUSES: Mapping[str, tuple[str, ...]] = {
    "nominal": (),
    "model errors": ("stiffness", "damping", "tension_gain"),
    "latency": ("latency",),
    "load": ("payload", "gravity.acceleration"),
    "actuation": ("tendon_friction.coefficient", "actuators.time_constant"),
    "pushes": tuple(f"disturbance.loads.{i}.force" for i in range(3)),
}
"""Names in `randomize` of a training, by the cause of errors."""
PERCENT = 100.0
HEADER = ("arm", "CPU of the training [min]", *CAUSES, "bad [%]")


def main() -> None:
    parser = parser_of(__doc__)
    names = [*scene_names(), *OWN]
    parser.add_argument("--arms", nargs="+", default=names, choices=names)
    parser.add_argument("--steps", type=int, default=1_000_000, help="steps of a training")
    parser.add_argument("--episodes", type=int, default=48, help="episodes of a cause")
    arguments = parser.parse_args()
    arms = ["three_tendon"] if arguments.quick else arguments.arms
    steps = 500 if arguments.quick else arguments.steps
    episodes = 2 if arguments.quick else arguments.episodes
    rows = []
    for arm in arms:
        folder = arguments.out / "own_agents" / arm.replace(",", "").replace(" ", "_")
        training = training_of(arm, steps, folder)
        started = time.process_time()
        train(training, folder)
        minutes = (time.process_time() - started) / 60.0
        rows.append([arm, f"{minutes:.1f}", *errors(training, folder, episodes)])
    write_csv(arguments.out / "own_agents.csv", HEADER, rows)
    text = (
        f"{episodes} episodes of a cause; errors in % of the length, interquartile mean and worst."
    )
    write_tables(arguments.out / "own_agents.md", f"{text}\n\n{markdown_table(HEADER, rows)}")


def training_of(arm: str, steps: int, folder: Path) -> Training:
    """The training of an agent for an arm, by name; the scene of an own one is in a file then."""
    scene = arm
    if arm in ARMS:
        folder.mkdir(parents=True, exist_ok=True)
        path = folder / "arm.toml"
        path.write_text(tomli_w.dumps(ARMS[arm]), encoding="utf-8")
        scene = str(path)
    changes = [f"options.scene={scene}", f"evaluation.every={steps}"]
    return read_training(find_config(CONFIG), changes, steps=steps)


def errors(training: Training, folder: Path, episodes: int) -> list[str]:
    """Cells of a row: errors by cause, and the share of bad episodes of all."""
    cells = []
    bad = []
    for names in CAUSES.values():
        scores = play(training, folder, names, episodes)
        shares = [PERCENT * score.errors["position_error"].rms / score.length for score in scores]
        cells.append(f"{interquartile_mean(shares):.2g} ({max(shares):.2g})")
        bad += [score.bad for score in scores]
    share_of_bad = PERCENT * sum(bad) / len(bad)
    return [*cells, f"{share_of_bad:.2g}"]


def play(
    training: Training, folder: Path, names: tuple[str, ...], episodes: int
) -> list[EpisodeScore]:
    """Scores of the last agent of a training, with what it draws by these names alone."""
    drawn = training.options["randomize"]
    causes: dict[str, Any] = {name: drawn[name] for name in names if name in drawn}
    effects = {name: drawn["effects"][name] for name in names if name in drawn["effects"]}
    target, *_ = training.options["target"]["of"]
    options = {
        **training.options,
        "target": target,
        "randomize": {**causes, "effects": effects},
    }
    skip = training.evaluation.skip
    steps = episode_steps(training.seconds, skip, options)
    seeds = SEEDS["arena"][:episodes]
    with closing(
        gym.make_vec(IDS[TASK], num_envs=episodes, max_episode_steps=steps, **options)
    ) as envs:
        policy = load_policy(str(folder / "last"), envs)
        return evaluate_rows(policy, envs, seeds, skip)


if __name__ == "__main__":
    main()
