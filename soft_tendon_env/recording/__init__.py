"""Episodes recorded to files that the Rerun viewer plays.

`pip install "soft_tendon_env[recording]"`, then `rerun FILE`.

Importing this package imports nothing of Rerun. `recording.rerun_file`, which has `RerunFile`,
does, and so do the wrappers once they are made.
"""

from soft_tendon_env.drawing.shapes import side_by_side
from soft_tendon_env.recording.rollout import Rollout, RolloutBuffer, collect
from soft_tendon_env.recording.wrappers import RecordRollout, VectorRecordRollout

__all__ = [
    "RecordRollout",
    "Rollout",
    "RolloutBuffer",
    "VectorRecordRollout",
    "collect",
    "side_by_side",
]
