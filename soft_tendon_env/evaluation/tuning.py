"""Robust tuning: a search for parameters of controllers and of the Kalman filter over arms that differ from what is believed of them.

    python -m soft_tendon_env.evaluation.tuning predictive --trials 30

The arms are `fine`, with combined errors, latency and noise as drawn for agents that train; their seeds are apart from all that anything is
evaluated on. Printed are the cost of every trial, and the best parameters: `robust_predictive` and `robust_tracking` of the catalogue were
found so.
"""

import argparse
from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from soft_tendon_env.control.catalogue import predictive_entry, tip_pose_objective, tracking_entry
from soft_tendon_env.control.kalman import USUAL
from soft_tendon_env.control.predictive import DEFAULT
from soft_tendon_env.evaluation.conditions import COMBINED, NOISE
from soft_tendon_env.evaluation.play import validation_error
from soft_tendon_env.evaluation.seeds import SEEDS
from soft_tendon_env.policies.controller_policy import ControllerPolicy, make_policy, observation_options

ERRORS: Mapping[str, Any] = {**COMBINED, "latency": (0.0, 0.04), "noise": NOISE}
"""Unknown errors of the arms, values of the option `randomize`."""
REGIMES = "tip", "sensors"
BELIEF = "fast"
"""Fidelity of the model that is believed in: under noise as good as any, and the cheapest."""

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


def cost(tunable: Tunable, values: Values, seeds: Sequence[int] = SEEDS["tuning"]) -> float:
    """Mean over REGIMES [m], see `validation_error`."""
    costs = []
    for regime in REGIMES:
        options = observation_options("predictive", "TipPose", estimator="adaptive", regime=regime)
        arms = {**options, "fidelity": "fine", "randomize": ERRORS}
        costs.append(validation_error(lambda envs: tunable.make(values, envs), "TipPose", arms, seeds))
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
