"""Errors of agents for arms of one's own, trained in ten minutes each: a table and a CSV file.

    python benchmarks/own_agents.py [--arms three_tendon ...] [--steps 1000000] [--episodes 48]
    [--quick] [--out out]

Each arm gets an agent by `configs/apg_tip_pose.toml`, whose numbers are shares of the arm. The
agent then plays the first targets of its training: on the arm as it is, and with one cause of
errors at a time that the training draws. Errors are root mean squares of the tip's position from
`evaluation.skip` on, as shares of the rod's length. An arm with few tendons cannot hold a pose
under a load: what MPC reaches there says so. A training that is complete in OUT is not repeated.
"""

import time
from collections.abc import Iterable, Mapping
from contextlib import closing
from itertools import chain
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
from soft_tendon_env.learning.train import checkpoint_to_resume, train
from soft_tendon_env.policies import load_policy, policy_options
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
LOAD = "load"
CONTROLLER = "filtered:predictive"
"""Model-based controller, whose errors under a load stand beside the agent's."""
OF_ARM = ("scene", "control_period", "fidelity", "sensors")
"""Options of the training that the controller has too."""
PERCENT = 100.0
MINUTES = "cpu_minutes.txt"
"""Name of the file with the CPU time of a complete training."""
HEADER = (
    "arm",
    "CPU of the training [min]",
    *CAUSES,
    "bad, of all [%]",
    f"bad, {LOAD} [%]",
    f"{LOAD}, MPC",
    f"bad, {LOAD}, MPC [%]",
)


def main() -> None:
    parser = parser_of(__doc__)
    names = [*scene_names(), *OWN]
    parser.add_argument("--arms", nargs="+", default=names, choices=names)
    parser.add_argument("--steps", type=int, default=1_000_000, help="steps of a training")
    parser.add_argument("--episodes", type=int, default=48, help="episodes of a cause")
    arguments = parser.parse_args()
    arms = ["sags"] if arguments.quick else arguments.arms
    steps = 500 if arguments.quick else arguments.steps
    episodes = 2 if arguments.quick else arguments.episodes
    rows = []
    for arm in arms:
        name = arm.replace(",", "").replace(" ", "_")
        folder = arguments.out / "own_agents" / f"{steps}_steps" / name
        training = training_of(arm, steps, folder)
        minutes = trained(training, folder)
        rows.append([arm, minutes, *errors(training, folder, episodes)])
        # what is there is shown, since all arms take hours
        write_csv(arguments.out / "own_agents.csv", HEADER, rows)
        text = (
            f"{episodes} episodes of a cause; errors in % of the length, interquartile mean and"
            " worst."
        )
        write_tables(arguments.out / "own_agents.md", f"{text}\n\n{markdown_table(HEADER, rows)}")


def trained(training: Training, folder: Path) -> str:
    """CPU minutes of a training, which is run where the folder has none that is complete."""
    file = folder / MINUTES
    if file.exists():
        # an agent of another configuration is refused
        checkpoint_to_resume(folder, training, resume=True)
    else:
        started = time.process_time()
        train(training, folder)
        minutes = (time.process_time() - started) / 60.0
        file.write_text(f"{minutes:.1f}", encoding="utf-8")
    return file.read_text(encoding="utf-8")


def training_of(arm: str, steps: int, folder: Path) -> Training:
    """The training of an agent for an arm, by name; the scene of an own one is in a file then."""
    scene = arm
    if arm in ARMS:
        folder.mkdir(parents=True, exist_ok=True)
        path = folder / "arm.toml"
        path.write_text(tomli_w.dumps({"name": arm, **ARMS[arm]}), encoding="utf-8")
        scene = str(path)
    changes = [f"options.scene={scene}", f"evaluation.every={steps}"]
    return read_training(find_config(CONFIG), changes, steps=steps)


def errors(training: Training, folder: Path, episodes: int) -> list[str]:
    """Cells of a row: errors by cause and bad episodes of the agent, and MPC's under a load."""
    agent = str(folder / "last")
    cells = []
    every_score: dict[str, list[EpisodeScore]] = {}
    for cause, names in CAUSES.items():
        scores = play(training, agent, training.options, names, episodes)
        cells.append(error_cell(scores))
        every_score[cause] = scores
    cells += [bad_cell(chain(*every_score.values())), bad_cell(every_score[LOAD])]

    arm = {name: training.options[name] for name in OF_ARM}
    arm["rate_limit"] = training.options["tension_rate"]  # as the agent's increments
    options = {**arm, **policy_options(CONTROLLER, TASK, arm)}
    scores = play(training, CONTROLLER, options, CAUSES[LOAD], episodes)
    return [*cells, error_cell(scores), bad_cell(scores)]


def error_cell(scores: list[EpisodeScore]) -> str:
    """Interquartile mean and worst of the position's errors, in percent of the length."""
    shares = [PERCENT * score.errors["position_error"].rms / score.length for score in scores]
    return f"{interquartile_mean(shares):.2g} ({max(shares):.2g})"


def bad_cell(scores: Iterable[EpisodeScore]) -> str:
    """Share of bad episodes, in percent."""
    bad = [score.bad for score in scores]
    share = PERCENT * sum(bad) / len(bad)
    return f"{share:.2g}"


def play(
    training: Training,
    policy: str,
    observed: Mapping[str, Any],
    names: tuple[str, ...],
    episodes: int,
) -> list[EpisodeScore]:
    """Scores of a policy on targets of a training, with what it draws by these names alone.

    observed: options of the environment, as the policy needs it.
    """
    drawn = training.options["randomize"]
    causes: dict[str, Any] = {name: drawn[name] for name in names if name in drawn}
    effects = {name: drawn["effects"][name] for name in names if name in drawn["effects"]}
    target, *_ = training.options["target"]["of"]
    options = {
        **observed,
        "target": target,
        "randomize": {**causes, "effects": effects},
    }
    skip = training.evaluation.skip
    steps = episode_steps(training.seconds, skip, options)
    seeds = SEEDS["arena"][:episodes]
    with closing(
        gym.make_vec(IDS[TASK], num_envs=episodes, max_episode_steps=steps, **options)
    ) as envs:
        loaded = load_policy(policy, envs)
        return evaluate_rows(loaded, envs, seeds, skip)


if __name__ == "__main__":
    main()
