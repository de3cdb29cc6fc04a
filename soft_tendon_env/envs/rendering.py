"""placeholder until merged"""
from typing import Any, NamedTuple


class Picture(NamedTuple):
    strain: Any; tension: Any; trail: Any; target_pose: Any; target_backbone: Any; title: str
class ArmRenderer:
    def __init__(self, model: Any, width: int = 640, height: int = 480) -> None: ...
