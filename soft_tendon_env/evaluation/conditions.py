"""Conditions that policies are judged under: how the arm differs from its model (model errors, settings), which targets they follow
(difficulties), and on which seeds; what they observe is one of REGIMES in policies/regimes.py.

To add a condition, add an entry to its table, here or from your own module.
"""

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any

from soft_tendon_env.evaluation.metrics import BAD
from soft_tendon_env.policies.regimes import NOISE
from soft_tendon_env.scene.scene import Scene, rod_length
from soft_tendon_env.tools.configuration import not_among

NOMINAL = "nominal"
"""Model error and setting of an arm that is as its model says."""
AND = ","
"""Separator between the names of model errors that an arm has together."""

MODEL_ERRORS: dict[str, Mapping[str, Any]] = {
    NOMINAL: {},
    "stiffness-20%": {"stiffness": 0.8},
    "stiffness+20%": {"stiffness": 1.2},
    "damping-halved": {"damping": 0.5},
    "damping-doubled": {"damping": 2.0},
    "payload-20g": {"payload": 0.02},  # a tenth of the paper's arm
    "tension-10%": {"tension_gain": 0.9},
    "tension+10%": {"tension_gain": 1.1},
    "noise": {"noise": {**NOISE, "curvature_rate": 0.5, "stretch_rate": 0.01}},
    "latency-20ms": {"latency": 0.02},
}
"""Single, fixed differences between the arm and its model, by name: values of the option `randomize`."""

COMBINED = {"stiffness": (0.8, 1.2), "damping": (0.5, 2.0), "payload": (0.0, 0.02), "tension_gain": (0.9, 1.1), "latency": (0.0, 0.02)}
"""Ranges from which all model errors are drawn together, as agents with domain randomisation train on them: values of `randomize`."""


def model_error(name: str) -> dict[str, Any]:
    """Values of the option `randomize` for a name of MODEL_ERRORS, or for several, "stiffness+20%,payload-20g".

    Raises ValueError for unknown names, and where two set the same value.
    """
    found: dict[str, Any] = {}
    for part in name.split(AND):
        if part not in MODEL_ERRORS:
            raise ValueError(f"names {part!r}: {not_among(part, MODEL_ERRORS)}; several at once with {AND!r} between them")
        if twice := found.keys() & MODEL_ERRORS[part].keys():
            raise ValueError(f"names {name!r}, in which {', '.join(sorted(twice))} is said twice")
        found |= MODEL_ERRORS[part]
    return found


@dataclass(frozen=True)
class Setting:
    """Perturbation of the arm that is unknown to the policy.

    scene: changes of the scene by dotted keys, such as effects, as a function of the scene. randomize: the environment's option, drawn
    anew for every episode.
    """

    description: str
    scene: Callable[[Scene], dict[str, Any]] = lambda scene: {}
    randomize: Mapping[str, Any] = field(default_factory=dict)


def _pushes(scene: Scene) -> dict[str, Any]:
    """Three pushes at the tip and in the middle, each a fifth of a second or more."""
    length = rod_length(scene)
    pulses = (length, 1.5, 0.2), (0.5 * length, 3.0, 0.4), (length, 4.5, 0.6)
    signals = [(place, {"type": "pulse", "start": start, "duration": duration}) for place, start, duration in pulses]
    return {"effects.disturbance.loads": [{"at": place, "force": [0.0, 0.0, 0.0], "signal": signal} for place, signal in signals]}


def _obstacles(scene: Scene) -> dict[str, Any]:
    """Two balls that swing through the middle of the arm's space, one along y, one along z, and begin beside it."""
    length = rod_length(scene)
    balls = []
    for place, amplitude, often in ((0.4, (0.0, 0.25 * length, 0.0), 0.3), (0.6, (0.0, 0.0, 0.25 * length), 0.4)):
        ball = {"type": "sphere", "radius": 0.05 * length, "position": [place * length, 0.0, 0.0]}
        balls.append({**ball, "amplitude": [*amplitude], "frequency": often, "phase": 90.0})
    return {"effects.contact": {"obstacles": balls}}


SETTINGS: dict[str, Setting] = {
    NOMINAL: Setting("the arm as its model says, at finer discretisation"),
    "model_errors": Setting("stiffness, damping, payload up to 20 g, tension gains and latency up to 20 ms, together", randomize=COMBINED),
    "latency": Setting("commands that arrive 0 to 60 ms late", randomize={"latency": (0.0, 0.06)}),
    "load": Setting(
        "a payload up to 50 g and gravity of any direction, up to 9.8 m/s^2",
        lambda scene: {"effects.gravity.acceleration": [0.0, 0.0, 0.0]},
        {"payload": (0.0, 0.05), "effects": {"gravity.acceleration": [(-5.66, 5.66)] * 3}},
    ),
    "actuation": Setting(
        "friction of tendons (coefficient up to 0.1) and first-order lag of actuators (5 to 40 ms)",
        lambda scene: {"effects.tendon_friction.coefficient": 0.05, "effects.actuators.time_constant": 0.03},
        {"effects": {"tendon_friction.coefficient": (0.0, 0.1), "actuators.time_constant": (0.005, 0.04)}},
    ),
    "obstacles": Setting(
        "two balls that swing through the middle of the arm's space and push it aside",
        _obstacles,
        {"effects": {f"contact.obstacles.{i}.phase": (60.0, 120.0) for i in range(2)}},
    ),
    "water": Setting(
        "immersion in water with a current up to 0.2 m/s each way",
        lambda scene: {"effects.fluid.density": 1000.0},
        {"effects": {"fluid.current": [(-0.2, 0.2)] * 3}},
    ),
    "pushes": Setting(
        "pushes at the tip and in the middle, up to 0.5 N each way",
        _pushes,
        {"effects": {f"disturbance.loads.{i}.force": [(-0.5, 0.5)] * 3 for i in range(3)}},
    ),
}
"""Settings of the arena by name."""

PLANT = "fine"
"""Fidelity of the arm that the arena plays on."""
BELIEF = "standard"
"""Fidelity of the model that controllers believe in, unless their name says another, as in filtered:predictive@fast."""


@dataclass(frozen=True)
class Difficulty:
    """Target to follow: the environment's option `target`. bad: share of the rod's length above which an episode counts as bad, see
    `EpisodeScore.is_bad`; infinite where the target cannot be reached: only divergence does."""

    description: str
    target: Mapping[str, Any]
    bad: float = BAD


DIFFICULTIES: dict[str, Difficulty] = {
    "easy": Difficulty("small and slow: tensions within a quarter of their range, a knot a second", {"type": "random"}),
    "medium": Difficulty("within 0.4 of it, a knot every 0.6 s", {"type": "random", "fraction": 0.4, "knot_period": 0.6}),
    "hard": Difficulty("within 0.6 of it, a knot every 0.3 s", {"type": "random", "fraction": 0.6, "knot_period": 0.3}),
    "steps": Difficulty("set points that change every 2 s", {"type": "steps", "fraction": 0.4}),
    "out_of_reach": Difficulty("a pose 1.2 lengths away from the base", {"type": "out_of_reach", "fraction": 0.4}, bad=math.inf),
}
"""Difficulties by name."""

SEEDS = {
    "tuning": range(100, 112),
    "evaluation": range(1_000_000, 1_000_020),
    "arena": range(2_000_000, 2_001_000),
    "validation": range(3_000_000, 3_000_100),
    "training": range(2**32, 2**32 + 2**48),
}
"""Ranges of seeds of `reset` by purpose. No two share a seed, which is asserted: policies are not judged on what chose them. Parameters of
controllers are tuned on "tuning"; `evaluate`, `compare` and `demo` judge on "evaluation", `arena` on "arena"; learning curves are measured,
and the best agent of a training chosen, on "validation"; arms that agents train on draw theirs from "training"."""

_ordered = sorted(SEEDS.values(), key=lambda seeds: seeds.start)
assert all(one.stop <= other.start for one, other in zip(_ordered, _ordered[1:], strict=False)), "every seed has one purpose"

EVALUATION_SEEDS = tuple(SEEDS["evaluation"])
"""Fixed list of episodes on which agents and controllers are compared."""
VALIDATION_SEEDS = tuple(SEEDS["validation"])
"""Fixed list of episodes of learning curves, on which the best agent of a training is chosen."""
