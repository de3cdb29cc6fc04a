"""Conditions of the benchmark: how the arm differs from its model (settings), what policies observe of it (information regimes), and what
they are to follow (difficulties). To add one, add an entry to its table here, or to the table from a module of your own.
"""

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any

from soft_tendon_env.policies import controller_policy
from soft_tendon_env.scene.scene import Scene, rod_length

PLANT = "fine"
"""Fidelity of the arm that is played on."""
BELIEF = "standard"
"""Fidelity of the model that controllers believe in, unless their name says another, as in filtered:predictive@fast."""


def _unchanged(scene: Scene) -> dict[str, Any]:
    return {}


@dataclass(frozen=True)
class Setting:
    """What the arm has that no policy is told of.

    scene: changes of the scene by dotted keys, such as effects, which may depend on the scene. randomize: the environment's option, drawn
    anew for every episode.
    """

    description: str
    scene: Callable[[Scene], dict[str, Any]] = _unchanged
    randomize: Mapping[str, Any] = field(default_factory=dict)


def _in_water(scene: Scene) -> dict[str, Any]:
    return {"effects.fluid.density": 1000.0}


def _weighed(scene: Scene) -> dict[str, Any]:
    return {"effects.gravity.acceleration": [0.0, 0.0, 0.0]}


def _driven(scene: Scene) -> dict[str, Any]:
    return {"effects.tendon_friction.coefficient": 0.05, "effects.actuators.time_constant": 0.03}


def _pushed(scene: Scene) -> dict[str, Any]:
    """Three pushes at the tip and in the middle, each a fifth of a second or more."""
    length = rod_length(scene)
    pulses = [(length, 1.5, 0.2), (0.5 * length, 3.0, 0.4), (length, 4.5, 0.6)]
    signals = [{"type": "pulse", "start": start, "duration": duration} for _, start, duration in pulses]
    return {
        "effects.disturbance.loads": [
            {"at": place, "force": [0.0, 0.0, 0.0], "signal": signal} for (place, _, _), signal in zip(pulses, signals, strict=True)
        ]
    }


def _among(scene: Scene) -> dict[str, Any]:
    """Two balls that swing through the middle of the arm's space, one along y, one along z, and begin beside it."""
    length = rod_length(scene)
    swings = [(0.4, (0.0, 0.25 * length, 0.0), 0.3), (0.6, (0.0, 0.0, 0.25 * length), 0.4)]
    balls = []
    for place, amplitude, often in swings:
        ball = {"type": "sphere", "radius": 0.05 * length, "position": [place * length, 0.0, 0.0]}
        balls.append({**ball, "amplitude": [*amplitude], "frequency": often, "phase": 90.0})
    return {"effects.contact": {"obstacles": balls}}


MODEL_ERRORS = {"stiffness": (0.8, 1.2), "damping": (0.5, 2.0), "payload": (0.0, 0.02), "tension_gain": (0.9, 1.1), "latency": (0.0, 0.02)}
"""What agents with domain randomisation train on too."""

SETTINGS: dict[str, Setting] = {
    "nominal": Setting("the arm as its model says, at finer discretisation"),
    "model_errors": Setting(
        "stiffness, damping, payload up to 20 g, tension gains and latency up to 20 ms, together", randomize=MODEL_ERRORS
    ),
    "latency": Setting("commands that arrive 0 to 60 ms late", randomize={"latency": (0.0, 0.06)}),
    "load": Setting(
        "a payload up to 50 g and gravity of any direction, up to 9.8 m/s^2",
        _weighed,
        {"payload": (0.0, 0.05), "effects": {"gravity.acceleration": [(-5.66, 5.66)] * 3}},
    ),
    "actuation": Setting(
        "friction of tendons (coefficient up to 0.1) and first-order lag of actuators (5 to 40 ms)",
        _driven,
        {"effects": {"tendon_friction.coefficient": (0.0, 0.1), "actuators.time_constant": (0.005, 0.04)}},
    ),
    "obstacles": Setting(
        "two balls that swing through the middle of the arm's space and push it aside",
        _among,
        {"effects": {f"contact.obstacles.{i}.phase": (60.0, 120.0) for i in range(2)}},
    ),
    "water": Setting(
        "immersion in water with a current up to 0.2 m/s each way", _in_water, {"effects": {"fluid.current": [(-0.2, 0.2)] * 3}}
    ),
    "pushes": Setting(
        "pushes at the tip and in the middle, up to 0.5 N each way",
        _pushed,
        {"effects": {f"disturbance.loads.{i}.force": [(-0.5, 0.5)] * 3 for i in range(3)}},
    ),
}
"""By name."""

NOISE = {"position": 1e-3, "rotation": math.radians(0.5), "length": 5e-4, "curvature": 0.05, "stretch": 1e-3}
"""Standard deviations of the sensors' noise, where there is any: 1 mm, half a degree, 0.5 mm of tendon, 0.05 1/m, a thousandth."""

TARGET_GROUPS = ("target_error", "target_twist", "preview", "last_action", "command", "inverse_statics", "target_lengths")
"""What is told in every regime: of the target, what holds it by a model, and what was asked for."""


@dataclass(frozen=True)
class Regime:
    """What policies may observe, besides TARGET_GROUPS and their history. None of it depends on how the arm is discretised: coordinates do,
    and are in no regime. noise: standard deviations, as the option `randomize.noise`."""

    description: str
    measured: controller_policy.Regime
    noise: Mapping[str, float] = field(default_factory=dict)

    @property
    def groups(self) -> tuple[str, ...]:
        """All that may be observed."""
        return *self.measured.groups, *TARGET_GROUPS


REGIMES: dict[str, Regime] = {
    "state": Regime(
        "tip pose and twist, tendon displacements, strains and their rates at up to eight sensors, all exact",
        controller_policy.REGIMES["state"],
    ),
    "sensors": Regime(
        "tip pose, tendon displacements and three strain sensors, all with noise", controller_policy.REGIMES["sensors"], NOISE
    ),
    "tip": Regime("tip pose and tendon displacements, with noise", controller_policy.REGIMES["tip"], NOISE),
}
"""By name, each with less than the one before."""


BAD = 0.02
"""Of the rod's length, the root mean square position error above which an episode counts as bad."""


@dataclass(frozen=True)
class Difficulty:
    """What is to be followed: the environment's option `target`. bad: root mean square position error, as a share of the rod's length,
    above which an episode counts as bad; None: only divergence does, where the target jumps or cannot be reached."""

    description: str
    target: Mapping[str, Any]
    bad: float | None = BAD


DIFFICULTIES: dict[str, Difficulty] = {
    "easy": Difficulty("small and slow: tensions within a quarter of their range, a knot a second", {"type": "random"}),
    "medium": Difficulty("within 0.4 of it, a knot every 0.6 s", {"type": "random", "fraction": 0.4, "knot_period": 0.6}),
    "hard": Difficulty("within 0.6 of it, a knot every 0.3 s", {"type": "random", "fraction": 0.6, "knot_period": 0.3}),
    "steps": Difficulty("set points that change every 2 s", {"type": "steps", "fraction": 0.4}, bad=None),
    "out_of_reach": Difficulty("a pose 1.2 lengths away from the base", {"type": "out_of_reach", "fraction": 0.4}, bad=None),
}
"""By name."""
