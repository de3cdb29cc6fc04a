"""Episodes for the Rerun viewer, recorded to files (`rerun FILE` plays them) or streamed: `pip install "soft_tendon_env[recording]"`.

Importing this package imports nothing of Rerun; `RerunFile` and `RerunViewer`, and the wrappers once they are made, do.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

from soft_tendon_env.recording.collect import collect
from soft_tendon_env.recording.geometry import side_by_side
from soft_tendon_env.recording.pictures import save_picture
from soft_tendon_env.recording.rollout import Rollout, RolloutBuffer
from soft_tendon_env.recording.wrappers import RecordRollout, VectorRecordRollout

if TYPE_CHECKING:
    from soft_tendon_env.recording.live import RerunViewer
    from soft_tendon_env.recording.rerun_file import RerunFile

__all__ = [
    "RecordRollout",
    "RerunFile",
    "RerunViewer",
    "Rollout",
    "RolloutBuffer",
    "VectorRecordRollout",
    "collect",
    "save_picture",
    "side_by_side",
]

NEED_RERUN = {"RerunFile": "rerun_file", "RerunViewer": "live"}


def __getattr__(name: str) -> Any:
    if name not in NEED_RERUN:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(f"{__name__}.{NEED_RERUN[name]}"), name)
