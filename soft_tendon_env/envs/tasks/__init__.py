"""Tasks, one object per file; see base.py for what a task says and `register_task` for tasks of your own."""

import importlib
import pkgutil

from soft_tendon_env.envs.tasks.base import STATIONS, TASKS, Task, register_task
from soft_tendon_env.envs.tracking import Tracking, TrackingError, register_reward_term

for _module in pkgutil.iter_modules(__path__):
    importlib.import_module(f"{__name__}.{_module.name}")

__all__ = ["STATIONS", "TASKS", "Task", "Tracking", "TrackingError", "register_reward_term", "register_task"]
