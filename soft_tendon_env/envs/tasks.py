"""Tasks: what is observed, which tracking errors count, what is rewarded.

An environment is an arm and a task.

A task is one object, here or in a file of a user: `register("task", "Name", Task(...))`;
`examples/own_task.py` is one from outside.
"""

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

from soft_tendon_env.envs.observation import GROUPS, Group
from soft_tendon_env.envs.targets import TARGETS
from soft_tendon_env.envs.tracking import (
    ANGLE,
    BACKBONE,
    COORDINATES,
    POSITION,
    TERMS,
    Term,
    Tracking,
    TrackingError,
)
from soft_tendon_env.registration import MAX_EPISODE_STEPS, id_of, register_environment
from soft_tendon_env.tools.configuration import not_among, not_registered, shown
from soft_tendon_env.tools.registry import Registry, register

STATIONS = 20
"""Places along the backbone at which shapes are compared, the tip the last."""

OF_BASES = ("Episodes", "TendonRod")
"""Names that no task may have: <name>Env is a base of all environments."""

TIP = ("tip_position", "tip_rotation")
"""Observation groups that every task of the package has."""


@dataclass(frozen=True)
class Task:
    """Task: one object from which its environments are made.

    Attributes:
        description: the environments' docstring.
        target: name of the target unless options say otherwise, see targets/.
        observations: names of the groups of each named choice of the option `observation`, "full"
            the default.
        errors: what is measured at every step, the first of them what is to settle.
        reward: default weights by term: those of `errors`, "effort", "smoothness", and those of
            registered terms. Not for goals.
        reference: groups that give a controller its reference, where it observes the coordinates.
        measured_reference: groups that give a controller its reference, where a state estimator
            finds the coordinates.
        shapes: whether it compares whole shapes, and so needs a target that gives shapes.
        goal: for goal-conditioned tasks, what their goals (3,) [m] are.
        name: under which it is registered, as in the id `TendonRod-<name>-v0` and the classes
            `<name>Env`, `<name>VectorEnv`.
    """

    description: str
    target: str
    observations: Mapping[str, tuple[str, ...]]
    errors: tuple[TrackingError, ...]
    reward: Mapping[str, float] = field(default_factory=dict)
    reference: tuple[str, ...] = ()
    measured_reference: tuple[str, ...] = ()
    shapes: bool = False
    goal: str | None = None
    name: str = ""

    @property
    def terms(self) -> dict[str, Term]:
        """The reward terms that the task has, by name."""
        terms = dict(TERMS)
        for error in self.errors:
            terms |= error.terms
        return terms

    @property
    def observable(self) -> dict[str, Group]:
        """The groups that the task has, by name: those whose quantities its target has."""
        groups: dict[str, Group] = {}
        for name, group in GROUPS.items():
            lacks_shape = group.of_shape and not self.shapes
            lacks_target = group.of_target and self.goal is not None
            if not lacks_shape and not lacks_target:
                groups[name] = group
        return groups

    def __reduce__(self) -> tuple[Any, ...]:
        # pickled by name, since its functions have none; copies share it
        return task_named, (self.name,)

    @property
    def id(self) -> str:
        """Gymnasium's id of the environments."""
        return id_of(self.name)


def task_named(name: str) -> Task:
    """Registered task of a name. Raises ValueError that says what names there are."""
    if name not in TASKS:
        raise ValueError(f"task is {name!r}: {not_registered(name, TASKS)}")
    return TASKS[name]


def _checked_task(name: str, task: Any, *, max_episode_steps: int = MAX_EPISODE_STEPS) -> Task:
    """The task with its name, whose id Gymnasium knows then.

    Args:
        name: of the task.
        task: to be registered.
        max_episode_steps: after which Gymnasium truncates its episodes.

    Returns:
        The task.

    Raises:
        TypeError: for what is no task.
        ValueError: for another name than one word in capitals, and for what the task lacks, or
            names and does not exist.
    """
    if not isinstance(task, Task):
        raise TypeError(f"the task {name!r} should be a Task, not {shown(task)}")
    if not re.fullmatch("[A-Z][A-Za-z0-9]*", name):
        raise ValueError(
            f"a task's name should be one word in capitals such as 'TipPose', not {name!r}"
        )
    if name in OF_BASES:
        raise ValueError(
            f"the task's name {name!r} is taken, by the class {name}Env: choose another"
        )
    if not task.errors:
        raise ValueError(f"the task {name} lacks errors: at least one TrackingError is needed")
    if "full" not in task.observations:
        raise ValueError(f"the task {name} lacks the choice 'full' among its observations")
    groups = [*task.reference, *task.measured_reference]
    for names in task.observations.values():
        groups += names
    _check_names(name, [task.target], [*TARGETS])
    _check_names(name, groups, [*task.observable])
    _check_names(name, [*task.reward], [*task.terms])
    for error in task.errors:
        for term in error.terms.keys() & TERMS.keys():
            raise ValueError(
                f"the task {name} has the error {error.name!r} with the reward term {term!r}, whose"
                f" name is taken, by {TERMS.module_of(term)}: choose another name"
            )
    register_environment(name, max_episode_steps)
    return replace(task, name=name)


def _check_names(task: str, names: Sequence[str], valid: Sequence[str]) -> None:
    """Raises ValueError for the first of a task's names that is not valid."""
    for name in names:
        if name not in valid:
            raise ValueError(f"the task {task} names {name!r}: {not_among(name, valid)}")


TASKS: Registry[Task] = Registry("task", _checked_task)
"""Every registered task, by its name."""

TIP_POSE: Task = register(
    "task",
    "TipPose",
    Task(
        description="""
## Description
The policy moves the tip of a tendon-driven soft arm along a moving pose: position and orientation.
The arm is a Cosserat rod with the statics-based reduced dynamics of Mathew, Renda et al. (RA-L
2024). The default arm is the paper's, 1 m long with ten tendons.

## Action Space
`Box(-1, 1, (n_a,), float32)` has one entry per tendon; larger values are clipped. -1 and 1 are the
largest decrease and increase of a tension in one control period: `tension_rate`, 100 N/s, times 20
ms is 2 N. Tensions stay within their limits, 0 and 60 N on the default arm: tendons pull and do not
push. With `action="tension"`, -1 and 1 are these limits, and tensions may jump.

## Observation Space
`Box(float32)` holds groups side by side: coordinates, rates, tip_position, tip_rotation, tip_twist,
target_error, target_twist, preview, last_action. Each is scaled to about 1 and clipped to ±10, the
two errors of the target to ±100. The option `observation` chooses others, see
docs/reference/environments.md.

## Rewards
The reward is a weighted mean of terms between 0 and 1, and 0 where the simulation diverged. `info`
has each term as `reward_<term>`.

- `graded_position` (weight 1) and `graded_angle` (0.25) are the mean of 1 / (1 + (error / scale)^2)
  over three scales: 0.2, 0.02 and 0.002 lengths of the rod, and 2, 0.2 and 0.02 rad.
- `effort` (0.02) is 1 minus the mean square tension, as a share of the limits.
- `smoothness` (0.1) is 1 minus a quarter of the mean square change of the action.
- `position` and `angle`, weight 0 by default, have one scale, 0.05 lengths and 0.5 rad.

## Starting State
The arm rests under the tensions nearest to zero. The target is drawn at every reset. By default it
is a closed smooth random motion through poses that the arm can hold. `reset(options=...)` sets
both.

## Episode End
An episode is truncated after 500 steps, 10 s at the default control period, unless `gym.make` is
given `max_episode_steps`. It is terminated if no time step of the simulation succeeds, however
small. Then `info["diverged"]` is true, `info["cause"]` says why, and the observation is the last
good one.

## Arguments
Every environment takes the keyword arguments of `soft_tendon_env.envs.Options`.
""",
        target="random",
        observations={
            "full": (
                "coordinates",
                "rates",
                *TIP,
                "tip_twist",
                "target_error",
                "target_twist",
                "preview",
                "last_action",
            ),
            "measurable": (
                *TIP,
                "tendon_lengths",
                "strain",
                "target_error",
                "target_twist",
                "preview",
                "last_action",
            ),
        },
        errors=(POSITION, ANGLE),
        reward={"graded_position": 1.0, "graded_angle": 0.25, "effort": 0.02, "smoothness": 0.1},
        reference=("target_error", "preview"),
        measured_reference=("target_error", "preview"),
    ),
)

SHAPE: Task = register(
    "task",
    "Shape",
    Task(
        description="""
## Description
The policy moves the whole arm through a sequence of shapes: the static equilibria under given
tensions (shape control of Mathew, Renda et al., RA-L 2024, Section IV-A). Actions, episode end and
arguments are those of `TipPoseEnv`. The target must be defined by tensions; with `target="ramp"` it
is the paper's: tensions rise from rest for 2.5 s and are then held.

## Observation Space
`Box(float32)` holds groups side by side: coordinates, rates, tip_position, tip_rotation,
target_coordinates, coordinate_preview, last_action. See docs/reference/environments.md.

## Rewards
As in `TipPoseEnv`, with the term `graded_backbone` (weight 1) in place of position and angle. Its
error is the root mean square distance between the backbone and the target, with the scales of
`graded_position`. `backbone`, `coordinates` (norm of the coordinates' error) and `position` are
further terms, and their graded ones, with weight 0 by default.
""",
        target="random",
        observations={
            "full": (
                "coordinates",
                "rates",
                *TIP,
                "target_coordinates",
                "coordinate_preview",
                "last_action",
            ),
            "measurable": (
                *TIP,
                "tendon_lengths",
                "strain",
                "target_error",
                "target_lengths",
                "preview",
                "last_action",
            ),
        },
        errors=(BACKBONE, COORDINATES, POSITION),
        reward={"graded_backbone": 1.0, "effort": 0.02, "smoothness": 0.1},
        reference=("target_coordinates", "coordinate_preview"),
        measured_reference=("target_error", "preview", "wanted_coordinates"),
        shapes=True,
    ),
)

REACH: Task = register(
    "task",
    "Reach",
    Task(
        description="""
## Description
The policy brings the tip of a tendon-driven soft arm to a point. The task is goal-conditioned.
Actions, starting state, episode end and arguments are those of `TipPoseEnv`, with the argument
`threshold`.

## Observation Space
`Dict` with three entries. `observation` has the groups coordinates, rates, tip_position,
tip_rotation, tip_twist, last_action. `achieved_goal` and `desired_goal` are tip positions in
metres, `Box((3,), float32)`.

## Rewards
`reward="sparse"` is 1 within `threshold` (0.01 lengths of the rod) of the goal, else 0.
`reward="dense"` is the mean of 1 / (1 + (distance / scale)^2) over scales of 20, 2 and 0.2
thresholds. `compute_reward(achieved_goal, desired_goal, info)` gives the same for many goals.

## Starting State
The goal is drawn: it is the tip's position at rest under random tensions. One within `threshold` of
where the tip begins is drawn again; a goal that is given stays. Reaching it does not end the
episode; `info["is_success"]` says whether the tip is there.
""",
        target="hold",
        observations={
            "full": ("coordinates", "rates", *TIP, "tip_twist", "last_action"),
            "measurable": (*TIP, "tendon_lengths", "strain", "last_action"),
        },
        errors=(POSITION,),
        goal="tip position",
    ),
)

__all__ = ["TASKS", "Task", "Tracking", "TrackingError"]
