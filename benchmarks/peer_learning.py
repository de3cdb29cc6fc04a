"""A peer's learning task in three ways: PPO with their settings, PPO with this package's, and the
analytic policy gradient.

    python benchmarks/peer_learning.py [--ways theirs ours apg] [--seeds 5] [--steps 0] [--quick]
    [--out out]

The task is `examples/follow_ball.py`, SoRoMoX's study of parallel reinforcement learning written
anew. Times are of training, without compilation, to the first update at which the last 100 whole
episodes had this mean return: wall time, and CPU time of the process. The distance is that of the
tip from the ball, in the mean of 50 unseen episodes without exploration. What their logs say stands
beside: of another simulator, on a GPU that is not named, of an arm with another damping of torsion,
stretch, shear.
"""

import argparse
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import matplotlib.pyplot as plt
import numpy as np
import torch
from _results import machine, markdown_table, write_csv, write_picture, write_tables
from stable_baselines3 import PPO
from stable_baselines3.common.base_class import BaseAlgorithm
from stable_baselines3.common.callbacks import BaseCallback
from stable_baselines3.common.vec_env import VecEnv, VecNormalize

from soft_tendon_env.learning.vec_env import make_sb3_vec_env

sys.path.insert(0, str(Path(__file__).parents[1] / "examples"))
import follow_ball

EXAMPLE = "examples/follow_ball.py"
ROWS = 64
EPISODES = 100
RETURNS = 0.0, 100.0
THEIR_LOGS = (
    ("SoRoMoX, PPO, 512 environments, the better of two runs", "1,180", "1,842", "104"),
    ("SoRoMoX, PPO, 64 environments, the better of two runs", "2,191", "6,637", "112"),
    ("PyElastica in their study, PPO, the better of two runs", "99", "5,885", "98"),
)
THEIR_HEADER = ("their logs", "wall time to 0 [s]", "to 100 [s]", "at the end")
THEIRS = (
    "What their logs say, on a GPU that is not named (PyElastica: a CPU), of a rod with another"
    " damping of torsion, stretch and shear:"
)
HEADER = (
    "way",
    "seed",
    "wall time to 0 [s]",
    "to 100 [s]",
    "CPU time to 0 [s]",
    "to 100 [s]",
    "steps to 0",
    "to 100",
    "at the end",
    "of",
    "distance [mm]",
)


def annealed(first: float, last: float) -> Callable[[float], float]:
    """Learning rate that falls from the first to the last in equal ratios over a training."""
    return lambda remaining: last * (first / last) ** remaining


def theirs(seed: int) -> BaseAlgorithm:
    """PPO with the settings of their study."""
    env = VecNormalize(make_env("full"))
    return PPO(
        "MlpPolicy",
        env,
        n_steps=200,
        batch_size=428,
        learning_rate=3e-4,
        gamma=0.99,
        gae_lambda=0.95,
        seed=seed,
        device="cpu",
    )


def ours(seed: int) -> BaseAlgorithm:
    """PPO as `configs/ppo_tip_pose_nominal.toml` has it."""
    env = VecNormalize(make_env("error"), norm_obs=False, gamma=0.95)
    kept: dict[str, Any] = {
        "n_steps": 32,
        "batch_size": 512,
        "n_epochs": 10,
        "target_kl": 0.03,
        "gamma": 0.95,
    }
    network = {"net_arch": [128, 128], "log_std_init": -1.0}
    return PPO(
        "MlpPolicy",
        env,
        learning_rate=annealed(1e-3, 1e-4),
        policy_kwargs=network,
        seed=seed,
        device="cpu",
        **kept,
    )


def apg(seed: int) -> BaseAlgorithm:
    """The analytic policy gradient as the example has it."""
    return follow_ball.learner(make_env("error", follow_ball.ROWS), seed)


class Way(NamedTuple):
    """How to train: a title, what makes the algorithm of a seed, and for how many steps."""

    title: str
    make: Callable[[int], BaseAlgorithm]
    steps: int
    observation: str


WAYS = {
    "theirs": Way("PPO, their settings", theirs, 1_000_000, "full"),
    "ours": Way("PPO, this package's settings", ours, 300_000, "error"),
    "apg": Way("APG", apg, 100_000, "error"),
}


def make_env(observation: str, rows: int = ROWS) -> VecEnv:
    return make_sb3_vec_env(
        follow_ball.ID, rows, threads=1, observation=observation, **follow_ball.OPTIONS
    )


class Curve(BaseCallback):
    """Mean returns of the last whole episodes, as theirs, after every rollout: `points` of (steps,
    wall time [s], CPU time [s], return)."""

    def __init__(self) -> None:
        super().__init__()
        self.points: list[tuple[int, float, float, float]] = []

    def _on_training_start(self) -> None:
        self._began = time.perf_counter(), time.process_time()

    def _on_step(self) -> bool:
        return True

    def _on_rollout_end(self) -> None:
        whole = [
            episode["r"]
            for episode in self.model.ep_info_buffer or ()
            if episode["l"] == follow_ball.PERIODS
        ]
        if len(whole) == EPISODES:
            wall = time.perf_counter() - self._began[0]
            cpu = time.process_time() - self._began[1]
            self.points.append(
                (self.num_timesteps, wall, cpu, follow_ball.their_return(float(np.mean(whole))))
            )

    def first_at(self, wanted: float) -> tuple[Any, ...]:
        """Steps, wall time [s] and CPU time [s] at the first mean return of at least so much,
        dashes where there was none."""
        return next((point[:3] for point in self.points if point[3] >= wanted), ("-",) * 3)


def trained(name: str, seed: int, steps: int) -> tuple[Curve, tuple[Any, ...]]:
    """The curve of a training and its row of the table. What compiles does so before, in a training
    of another seed."""
    way = WAYS[name]
    curve = Curve()
    way.make(seed + 1).learn(1)
    learner = way.make(seed)
    learner.learn(steps or way.steps, callback=curve)
    (first, wall, cpu), (there, to_there, cpu_there) = (
        curve.first_at(wanted) for wanted in RETURNS
    )
    end = curve.points[-1] if curve.points else ("-", "-", "-", "-")
    return curve, (
        way.title,
        seed,
        shown(wall),
        shown(to_there),
        shown(cpu),
        shown(cpu_there),
        first,
        there,
        shown(end[3]),
        end[0],
        shown(1e3 * distance_of(learner, way.observation)),
    )


def distance_of(learner: BaseAlgorithm, observation: str) -> float:
    """Mean distance [m] from balls that the training has not met, without exploration."""
    env: VecEnv = follow_ball.unseen_env(observation)
    seen = learner.get_vec_normalize_env()
    if seen is not None and seen.norm_obs:  # by the statistics at the training's end
        normalised = VecNormalize(env, training=False, norm_reward=False)
        normalised.obs_rms = seen.obs_rms
        env = normalised
    _, distance = follow_ball.play(learner, env)
    return distance


def shown(value: Any) -> str:
    return value if isinstance(value, str) else f"{value:.1f}"


def draw(curves: dict[str, list[Curve]], out: Path) -> None:
    """Learning curves against CPU time."""
    figure, axes = plt.subplots(figsize=(6.4, 4.0), layout="constrained")
    for color, (name, of_seeds) in enumerate(curves.items()):
        for i, curve in enumerate(of_seeds):
            cpu, returns = ([point[k] for point in curve.points] for k in (2, 3))
            axes.plot(cpu, returns, color=f"C{color}", label=None if i else WAYS[name].title)
    for wanted in RETURNS:
        axes.axhline(wanted, color="0.6", linewidth=0.8, linestyle=":")
    axes.set(xlabel="CPU time [s]", ylabel=f"return, mean of {EPISODES} episodes", xscale="log")
    axes.legend()
    write_picture(figure, out)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--ways", nargs="+", choices=list(WAYS), default=list(WAYS))
    parser.add_argument("--seeds", type=int, default=5, help="how many")
    parser.add_argument(
        "--steps", type=int, default=0, help="of every training; 0: as many as each way has"
    )
    parser.add_argument("--quick", action="store_true", help="a few episodes, to try it")
    parser.add_argument("--out", type=Path, default=Path("out"))
    arguments = parser.parse_args()
    torch.set_num_threads(1)
    steps = ROWS * follow_ball.PERIODS * 3 if arguments.quick else arguments.steps
    arguments.out.mkdir(parents=True, exist_ok=True)
    curves: dict[str, list[Curve]] = {name: [] for name in arguments.ways}
    rows = []
    for name in arguments.ways:
        for seed in range(arguments.seeds):
            curve, row = trained(name, seed, steps)
            curves[name].append(curve)
            rows.append(row)
    text = (
        f"{markdown_table(HEADER, rows)}\n\n{THEIRS}\n\n{markdown_table(THEIR_HEADER, THEIR_LOGS)}"
    )
    print(f"{machine()}; {ROWS} arms with PPO, {follow_ball.ROWS} with APG")
    write_tables(arguments.out / "peer_learning.md", text)
    write_csv(arguments.out / "peer_learning.csv", HEADER, rows)
    draw(curves, arguments.out / "peer_learning.png")


if __name__ == "__main__":
    main()
