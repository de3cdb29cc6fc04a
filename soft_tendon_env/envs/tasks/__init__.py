"""Tasks: what is observed, which tracking errors count, what is rewarded. An environment is an arm and a task.

A task is one object in one file, in this package or a user's own: `register_task(Task(...))`; `examples/own_task.py` is one from outside.
"""

import importlib
import pkgutil
import re
from collections.abc import Mapping
from dataclasses import dataclass, field

from soft_tendon_env.envs.observation import GROUPS, Group
from soft_tendon_env.envs.targets import TARGETS
from soft_tendon_env.envs.tracking import OWN_TERMS, TERMS, Term, Tracking, TrackingError, register_reward_term
from soft_tendon_env.registration import MAX_EPISODE_STEPS, register_environment, task_of_file
from soft_tendon_env.tools.configuration import not_among, not_registered

STATIONS = 20  # places along the backbone at which shapes are compared, the tip the last

TIP = ("tip_position", "tip_rotation")  # groups that every task of the package observes


@dataclass(frozen=True)
class Task:
    """A task: one object from which its environments are made.

    Attributes:
        name: as in the id `TendonRod-<name>-v0` and the classes `<name>Env`, `<name>VectorEnv`.
        description: the environments' docstring.
        target: name of the target unless options say otherwise, see targets/.
        observations: names of the groups of each named choice of the option `observation`, "full" the default.
        errors: what is measured at every step, the first of them what is to settle.
        reward: default weights by term: those of `errors`, "effort", "smoothness", and those of `register_reward_term`. Not for goals.
        groups: observation groups of the task's own, besides those of observation.py.
        reference: groups that give a controller its reference, where it observes the coordinates.
        measured_reference: groups that give a controller its reference, where a state estimator finds the coordinates.
        shapes: whether it compares whole shapes, and so needs a target that gives shapes.
        goal: for goal-conditioned tasks, what their goals (3,) [m] are.
    """

    name: str
    description: str
    target: str
    observations: Mapping[str, tuple[str, ...]]
    errors: tuple[TrackingError, ...]
    reward: Mapping[str, float] = field(default_factory=dict)
    groups: Mapping[str, Group] = field(default_factory=dict)
    reference: tuple[str, ...] = ()
    measured_reference: tuple[str, ...] = ()
    shapes: bool = False
    goal: str | None = None

    @property
    def terms(self) -> dict[str, Term]:
        """The reward terms that the task has, by name."""
        return {**OWN_TERMS, **{error.term: Term(error.name, error.scale, error.of_length) for error in self.errors}, **TERMS}

    @property
    def observable(self) -> dict[str, Group]:
        """The groups that the task has, by name: those whose quantities its target has."""
        lacks = {name for name, group in GROUPS.items() if group.of_shape and not self.shapes or group.of_target and self.goal is not None}
        return {**{name: group for name, group in GROUPS.items() if name not in lacks}, **self.groups}

    def __reduce__(self) -> str:
        return self.name  # pickled by name, since its functions have none; copies share it

    @property
    def id(self) -> str:
        """Gymnasium's id of the environments."""
        return f"TendonRod-{self.name}-v0"


TASKS: dict[str, Task] = {}
"""Every registered task, by its name."""


def register_task(task: Task, max_episode_steps: int = MAX_EPISODE_STEPS) -> Task:
    """Make a task known: its id to Gymnasium, its classes to `soft_tendon_env.envs`, its name to `make_policy`; returns the task.

    A second task of the same name replaces the first. Raises ValueError for another name than one word in capitals, and for a target or
    a group that does not exist.
    """
    if not re.fullmatch("[A-Z][A-Za-z0-9]*", task.name):
        raise ValueError(f"a task's name should be one word in capitals such as 'TipPose', not {task.name!r}")
    groups = [*task.reference, *task.measured_reference, *(name for names in task.observations.values() for name in names)]
    for names, valid in (([task.target], [*TARGETS]), (groups, [*task.observable])):
        if unknown := [name for name in names if name not in valid]:
            raise ValueError(f"the task {task.name} names {unknown[0]!r}: {not_among(unknown[0], valid)}")
    TASKS[task.name] = task
    register_environment(task.name, max_episode_steps)
    return task


def task_of_class(name: str, suffix: str, module: str) -> Task:
    """The registered task of the class `<task><suffix>`. Raises AttributeError, as modules do for what they do not have."""
    task = name.removesuffix(suffix)
    if not name.endswith(suffix) or task not in TASKS:
        raise AttributeError(f"module {module!r} has no attribute {name!r}; of tasks, {not_registered(task, TASKS)}")
    return TASKS[task]


def __getattr__(name: str) -> Task:
    """A registered task by its name: for pickles."""
    return task_of_class(name, "", __name__)


for _file in pkgutil.iter_modules(__path__):
    importlib.import_module(f"{__name__}.{_file.name}")
    if (_task := task_of_file(_file.name)) not in TASKS:  # whose id Gymnasium has from the file's name
        raise ImportError(f"envs/tasks/{_file.name}.py should register the task {_task!r}, as tip_pose.py does TipPose: rename one")

__all__ = ["STATIONS", "TASKS", "TIP", "Task", "Tracking", "TrackingError", "register_reward_term", "register_task", "task_of_class"]
