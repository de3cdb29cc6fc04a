"""Robust tuning: a search for parameters of controllers and of the Kalman filter over arms that differ from what is believed of them.

    python -m soft_tendon_env.evaluation.tuning predictive --trials 30

The arms are `fine`, with combined errors, latency and noise as drawn for agents that train; their seeds are apart from all that anything is
evaluated on. Printed are the cost of every trial, and the best parameters: `robust_predictive` and `robust_tracking` of the catalogue were
found so.
"""

import argparse
import math
from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from soft_tendon_env.control.catalogue import predictive_entry, tip_pose_objective, tracking_entry
from soft_tendon_env.control.kalman import USUAL
from soft_tendon_env.control.predictive import DEFAULT
from soft_tendon_env.envs import TipPoseVectorEnv
from soft_tendon_env.evaluation.run import run_rows
from soft_tendon_env.evaluation.scores import Episode
from soft_tendon_env.policies.controller_policy import ControllerPolicy, make_policy, observation_options
from soft_tendon_env.scene.scene import Array

SEEDS = tuple(range(100, 112))
"""Of the episodes that parameters are tuned on: neither EVALUATION_SEEDS nor those of the arena."""
ERRORS: Mapping[str, Any] = {
    "stiffness": (0.8, 1.2),
    "damping": (0.5, 2.0),
    "payload": (0.0, 0.02),
    "tension_gain": (0.9, 1.1),
    "latency": (0.0, 0.04),
    "noise": {"position": 1e-3, "rotation": math.radians(0.5), "length": 5e-4, "curvature": 0.05, "stretch": 1e-3},
}
"""What arms have that nobody knows, values of the option `randomize`."""
REGIMES = "tip", "sensors"
BELIEF = "fast"
"""Fidelity of the model that is believed in: under noise as good as any, and the cheapest."""
SECONDS, SKIPPED = 3.0, 1.0
WORST = 0.1
"""[m] that the error of an episode counts at most."""
CHATTER = 0.01
"""[m/N] that changes of tension above FAST [Hz] count."""
FAST = 10.0

Values = Mapping[str, Any]


class Tunable(NamedTuple):
    """What is tuned: the range of every parameter, where the search begins, and the policy that has them."""

    ranges: Mapping[str, tuple[float, float]]
    start: Values
    make: Callable[[Values, Any], ControllerPolicy]


def _tracking(values: Values, env: Any) -> ControllerPolicy:
    return make_policy(tracking_entry(tip_pose_objective, **values), env, BELIEF, estimator="adaptive")


def _predictive(values: Values, env: Any) -> ControllerPolicy:
    return make_policy(predictive_entry(tip_pose_objective, DEFAULT._replace(**values)), env, BELIEF, estimator="adaptive")


def _kalman(values: Values, env: Any) -> ControllerPolicy:
    return make_policy("predictive", env, BELIEF, estimator="adaptive", uncertainty=USUAL._replace(**values))


TUNABLE: Mapping[str, Tunable] = {
    "tracking": Tunable(
        {"settling_time": (0.1, 0.8), "damping": (0.7, 2.0), "integral_time": (0.3, 5.0)},
        {"settling_time": 0.2, "damping": 1.0, "integral_time": 0.5},
        _tracking,
    ),
    "predictive": Tunable(
        {"settling_time": (0.1, 0.8), "effort": (1e-3, 3e-2), "smoothness": (0.2, 3.0)},
        {"settling_time": DEFAULT.settling_time, "effort": DEFAULT.effort, "smoothness": DEFAULT.smoothness},
        _predictive,
    ),
    "kalman": Tunable(
        {"force": (5e-4, 2e-2), "tension": (5e-4, 3e-2), "offset": (2e-3, 0.2), "gain": (3e-3, 0.3), "tip": (2e-4, 2e-2)},
        {name: getattr(USUAL, name) for name in ("force", "tension", "offset", "gain", "tip")},
        _kalman,
    ),
}


def high_frequency_change(tension: Array, period: float, above: float = FAST) -> float:
    """Root mean square [N], over tendons and time, of what lies above a frequency [Hz] in the changes of tension (samples, n_a) [N]."""
    changes = np.diff(tension, axis=0)
    spectrum = np.fft.rfft(changes, axis=0)
    spectrum[np.fft.rfftfreq(len(changes), period) <= above] = 0.0
    return float(np.sqrt(np.mean(np.fft.irfft(spectrum, len(changes), axis=0) ** 2)))


def cost_of(episodes: Sequence[Episode]) -> float:
    """Mean over episodes [m]: error of the position, at most WORST, also for those that ended early, and CHATTER times the fast changes."""
    costs = []
    for episode in episodes:
        first = round(SKIPPED / episode.period)
        error = np.sqrt(np.mean(episode.errors["position_error"][first:] ** 2)) if episode.cause is None else WORST
        fast = high_frequency_change(episode.tension[first:], episode.period) if episode.cause is None else 0.0
        costs.append(min(error + CHATTER * fast, WORST))
    return float(np.mean(costs))


def cost(tunable: Tunable, values: Values, seeds: Sequence[int] = SEEDS) -> float:
    """Mean over REGIMES and seeds [m], see `cost_of`."""
    costs = []
    for regime in REGIMES:
        options = observation_options("predictive", "TipPose", estimator="adaptive", regime=regime)
        more: dict[str, Any] = {"fidelity": "fine", "randomize": ERRORS, "max_episode_steps": round(SECONDS / 0.02)}
        envs = TipPoseVectorEnv(num_envs=len(seeds), autoreset_mode="next_step", **more, **options)
        costs.append(cost_of(run_rows(tunable.make(values, envs), envs, seeds)))
        envs.close()
    return float(np.mean(costs))


def search(
    tunable: Tunable, objective: Callable[[Values], float], trials: int, generator: np.random.Generator
) -> tuple[dict[str, float], float]:
    """The best of `trials` and its cost: random ones over all of the ranges at first, then around the best with a spread that shrinks, both
    logarithmically."""
    best = dict(tunable.start)
    least = objective(best)
    least_values, greatest_values = np.array(list(tunable.ranges.values())).T
    low, high = np.log(least_values), np.log(greatest_values)
    for trial in range(1, trials):
        share = trial / trials
        drawn = generator.uniform(low, high)
        if share > 0.4:
            spread = 0.3 * (1.0 - share) + 0.05
            drawn = np.clip(np.log(list(best.values())) + spread * (high - low) * generator.normal(size=low.size), low, high)
        values = dict(zip(tunable.ranges, np.clip(np.exp(drawn), least_values, greatest_values).tolist(), strict=True))
        found = objective(values)
        if found < least:
            best, least = values, found
    return best, least


def main() -> None:
    """Run a search and print it."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("what", choices=TUNABLE)
    parser.add_argument("--trials", type=int, default=30)
    parser.add_argument("--seed", type=int, default=0, help="of the search")
    arguments = parser.parse_args()
    tunable = TUNABLE[arguments.what]

    def objective(values: Values) -> float:
        found = cost(tunable, values)
        print(f"{1e3 * found:9.4f} mm  " + "  ".join(f"{name} {value:.4g}" for name, value in values.items()), flush=True)
        return found

    best, least = search(tunable, objective, arguments.trials, np.random.default_rng(arguments.seed))
    print(f"best: {1e3 * least:.4f} mm  " + ", ".join(f"{name}={value:.3g}" for name, value in best.items()))


if __name__ == "__main__":
    main()
