"""Episodes recorded to files that the Rerun viewer plays.

`pip install "soft_tendon_env[recording]"`, then `rerun FILE`.

Importing this package imports nothing of Rerun; `RerunFile`, and the wrappers once they are made,
do.
"""

from typing import TYPE_CHECKING, Any

from soft_tendon_env.drawing.shapes import side_by_side
from soft_tendon_env.recording.rollout import Rollout, RolloutBuffer, collect
from soft_tendon_env.recording.wrappers import RecordRollout, VectorRecordRollout

if TYPE_CHECKING:
    from soft_tendon_env.recording.rerun_file import RerunFile

__all__ = [
    "RecordRollout",
    "RerunFile",
    "Rollout",
    "RolloutBuffer",
    "VectorRecordRollout",
    "collect",
    "side_by_side",
]


def __getattr__(name: str) -> Any:
    if name != "RerunFile":
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    from soft_tendon_env.recording.rerun_file import RerunFile

    return RerunFile
