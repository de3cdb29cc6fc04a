"""Target motions, one kind per file; see base.py for the contract and `register_target` for kinds of your own."""

import importlib
import pkgutil

from soft_tendon_env.envs.targets.base import (
    TARGETS,
    Course,
    PoseCourse,
    Setting,
    ShapeCourse,
    Target,
    TargetSamples,
    make_setting,
    pose_samples,
    register_target,
)

for _module in pkgutil.iter_modules(__path__):
    importlib.import_module(f"{__name__}.{_module.name}")

__all__ = [
    "TARGETS",
    "Course",
    "PoseCourse",
    "Setting",
    "ShapeCourse",
    "Target",
    "TargetSamples",
    "make_setting",
    "pose_samples",
    "register_target",
]
