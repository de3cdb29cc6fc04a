"""Conditions of an evaluation, and the seeds of the episodes.

A condition says what differs from the arm that policies know.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any

from soft_tendon_env.envs.options import given_scene
from soft_tendon_env.envs.randomization import Randomization
from soft_tendon_env.policies.regimes import NOISE
from soft_tendon_env.scene.scene import Scene, rod_length
from soft_tendon_env.tools.configuration import ConfigurationError, not_among, plain, shown
from soft_tendon_env.tools.registry import Registry, register

NOMINAL = "nominal"
AND = ","  # between the names of conditions that hold together


@dataclass(frozen=True)
class Condition:
    """Difference of an episode from nominal, unknown to the policy.

    It has values of `randomize`, changes of the scene by dotted keys, and other options of the
    environment.
    """

    description: str = ""
    randomize: Mapping[str, Any] = field(default_factory=dict)
    scene: Callable[[Scene], dict[str, Any]] = lambda scene: {}
    others: Mapping[str, Any] = field(default_factory=dict)

    def options(self, given: Mapping[str, Any]) -> dict[str, Any]:
        """Returns options of an environment under this condition.

        It overrides what the options have drawn.

        Args:
            given: options without the condition.

        Returns:
            Options by name.
        """
        options = dict(given)
        scene = given.get("scene", "paper")
        changes = self.scene(given_scene(scene))
        if changes:
            if isinstance(scene, Mapping):
                base = scene
            else:
                base = {"scene": scene}
            options["scene"] = {**base, **changes}
        options |= self.others
        drawn = plain(given.get("randomize", {}))
        options["randomize"] = {**drawn, **self.randomize}
        return options


def _checked_condition(name: str, condition: Any) -> Condition:
    """The condition itself. Raises TypeError, ValueError where it does not do."""
    if not isinstance(condition, Condition):
        raise TypeError(f"the condition {name!r} should be a Condition, not {shown(condition)}")
    if AND in name:
        raise ValueError(f"the condition's name {name!r} has {AND!r}, which stands between names")
    try:
        Randomization(**condition.randomize)
    except ConfigurationError as error:
        raise ConfigurationError(error.problems, f"the condition {name!r}") from error
    return condition


MODEL_ERRORS: Registry[Condition] = Registry("condition", _checked_condition)
"""Model errors, single and fixed: the conditions of `evaluate` and `compare`."""

_SHIPPED: dict[str, Condition] = {
    NOMINAL: Condition("the arm as its model says"),
    "stiffness-20%": Condition(randomize={"stiffness": 0.8}),
    "stiffness+20%": Condition(randomize={"stiffness": 1.2}),
    "damping-halved": Condition(randomize={"damping": 0.5}),
    "damping-doubled": Condition(randomize={"damping": 2.0}),
    "payload-20g": Condition(randomize={"payload": 0.02}),  # a tenth of the paper's arm
    "tension-10%": Condition(randomize={"tension_gain": 0.9}),
    "tension+10%": Condition(randomize={"tension_gain": 1.1}),
    "noise": Condition(randomize={"noise": {**NOISE, "curvature_rate": 0.5, "stretch_rate": 0.01}}),
    "latency-20ms": Condition(randomize={"latency": 0.02}),
}

for _name, _condition in _SHIPPED.items():
    register("condition", _name, _condition)


def _pushes(scene: Scene) -> dict[str, Any]:
    """Three pushes at the tip and in the middle, each a fifth of a second or more."""
    tip = rod_length(scene)
    middle = 0.5 * tip
    loads = []
    pulses = ((tip, 1.5, 0.2), (middle, 3.0, 0.4), (tip, 4.5, 0.6))
    for place, start, duration in pulses:
        pulse = {"type": "pulse", "start": start, "duration": duration}
        load = {"at": place, "force": [0.0, 0.0, 0.0], "signal": pulse}
        loads.append(load)
    return {"effects.disturbance.loads": loads}


def _obstacles(scene: Scene) -> dict[str, Any]:
    """Two balls that swing through the middle of the arm's space, and begin beside it.

    One swings along the base's y axis, one along z.
    """
    length = rod_length(scene)
    base = scene.base.pose
    swing = 0.25 * length
    balls = list[dict[str, Any]]()
    for place, amplitude, frequency in (
        (0.4, [0.0, swing, 0.0], 0.3),
        (0.6, [0.0, 0.0, swing], 0.4),
    ):
        axis = base[:3, 0]
        forward = place * length * axis
        middle = base[:3, 3] + forward
        ball = {
            "type": "sphere",
            "radius": 0.05 * length,
            "position": middle.tolist(),
            "amplitude": (base[:3, :3] @ amplitude).tolist(),
            "frequency": frequency,
            "phase": 90.0,
        }
        balls.append(ball)
    return {"effects.contact": {"obstacles": balls}}


SETTINGS: dict[str, Condition] = {
    NOMINAL: MODEL_ERRORS[NOMINAL],
    "easy": Condition(
        "nominal, and targets that are slower and nearer", others={"difficulty": "easy"}
    ),
    "hard": Condition(
        "nominal, and targets that are quicker and farther off", others={"difficulty": "hard"}
    ),
    "model_errors": Condition(
        "stiffness, damping, payload up to 20 g, tension gains and latency up to 20 ms, together",
        {
            "stiffness": (0.8, 1.2),
            "damping": (0.5, 2.0),
            "payload": (0.0, 0.02),
            "tension_gain": (0.9, 1.1),
            "latency": (0.0, 0.02),
        },
    ),
    "latency": Condition("commands that arrive 0 to 60 ms late", {"latency": (0.0, 0.06)}),
    "load": Condition(
        "a payload up to 50 g and gravity of any direction, up to 9.8 m/s^2",
        {"payload": (0.0, 0.05), "effects": {"gravity.acceleration": [(-5.66, 5.66)] * 3}},
        lambda scene: {"effects.gravity.acceleration": [0.0, 0.0, 0.0]},
    ),
    "actuation": Condition(
        "friction of tendons (coefficient up to 0.1) and first-order lag of actuators (5 to 40 ms)",
        {
            "effects": {
                "tendon_friction.coefficient": (0.0, 0.1),
                "actuators.time_constant": (0.005, 0.04),
            }
        },
        lambda scene: {
            "effects.tendon_friction.coefficient": 0.05,
            "effects.actuators.time_constant": 0.03,
        },
    ),
    "obstacles": Condition(
        "two balls that swing through the middle of the arm's space and push it aside",
        {"effects": {f"contact.obstacles.{i}.phase": (60.0, 120.0) for i in range(2)}},
        _obstacles,
    ),
    "water": Condition(
        "immersion in water with a current up to 0.2 m/s each way",
        {"effects": {"fluid.current": [(-0.2, 0.2)] * 3}},
        lambda scene: {"effects.fluid.density": 1000.0},
    ),
    "pushes": Condition(
        "pushes at the tip and in the middle, up to 0.5 N each way",
        {"effects": {f"disturbance.loads.{i}.force": [(-0.5, 0.5)] * 3 for i in range(3)}},
        _pushes,
    ),
}
"""Settings of the benchmark, and of searches for parameters of controllers."""


def model_error(names: str) -> Condition:
    """Returns the condition of a name of MODEL_ERRORS, or of several together.

    Args:
        names: one name, or several, "stiffness+20%,payload-20g".

    Returns:
        The condition.

    Raises:
        ValueError: for unknown names, and where two set the same value.
    """
    parts = list[Condition]()
    for name in names.split(AND):
        if name not in MODEL_ERRORS:
            raise ValueError(
                f"names {name!r}: {not_among(name, MODEL_ERRORS)}; several at once with {AND!r}"
                " between them"
            )
        parts.append(MODEL_ERRORS[name])
    # of two that set the same value one would be lost
    keys = [key for part in parts for key in part.randomize]
    twice = sorted({key for key in keys if keys.count(key) > 1})
    if twice:
        message = f"names {names!r}, in which {', '.join(twice)} is said twice"
        raise ValueError(message)

    def changes(scene: Scene) -> dict[str, Any]:
        together = dict[str, Any]()
        for part in parts:
            together |= part.scene(scene)
        return together

    randomize = dict[str, Any]()
    for part in parts:
        randomize |= part.randomize
    return Condition(names, randomize, changes)


SEEDS = {
    "tuning": range(100, 112),
    "evaluation": range(1_000_000, 1_000_020),
    "arena": range(2_000_000, 2_001_000),
    "validation": range(3_000_000, 3_000_100),
    "training": range(2**32, 2**32 + 2**48),
}
"""Ranges of seeds of `reset` by purpose, which share none: policies are not judged on what chose
them. Parameters of controllers are tuned on "tuning"; `evaluate`, `compare` and `demo` judge on
"evaluation", `arena` on "arena"; agents of a training are chosen on "validation"; arms that agents
train on draw theirs from "training"."""

EVALUATION_SEEDS = tuple(SEEDS["evaluation"])
"""Fixed list of episodes on which agents and controllers are compared."""
VALIDATION_SEEDS = tuple(SEEDS["validation"])
"""Fixed list of episodes of learning curves, on which the best agent of a training is chosen."""
