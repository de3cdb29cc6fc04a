"""Inputs of exported agents: what is measured of the arm and known of its target, in SI units, by the observation groups that need it."""

from collections.abc import Callable
from typing import NamedTuple

from soft_tendon_env.envs.episodes import Episodes
from soft_tendon_env.envs.observation import GROUPS, Group, Observed
from soft_tendon_env.tools.types import Array

UNITS = {
    "tip_twist": "rad/s, then m/s",
    "tendon_lengths": "m",
    "strain": "of each sensor 1/m, 1/m, 1/m, 1, 1, 1",
    "strain_rate": "of each sensor 1/(m s), 1/(m s), 1/(m s), 1/s, 1/s, 1/s",
    "target_twist": "rad/s, then m/s",
}
"""Units of groups that are inputs as they are; others have units of their own."""
STATES = ("last_action", "command")
"""Groups that an exported agent remembers by itself."""
POSES = ("tip_position", "tip_rotation", "target_error", "preview")
LENGTHS = "target_lengths"


class Measurement(NamedTuple):
    """An input: its shape, unit and description, and its value for a row of an environment."""

    shape: tuple[int, ...]
    unit: str
    description: str
    value: Callable[[Observed, int], Array]


def own_group(episodes: Episodes, name: str) -> bool:
    """Whether a group is made otherwise than the package's group of that name."""
    return group_of(episodes, name) is not GROUPS.get(name)


def group_of(episodes: Episodes, name: str) -> Group:
    """An observation group of an environment by name."""
    return episodes.task.observable[name]


def measurements(episodes: Episodes) -> dict[str, Measurement]:
    """Inputs by name, for the groups that an environment observes, in their order."""
    found: dict[str, Measurement] = {}
    for name, where in episodes.layout.slices.items():
        if name in episodes.task.observable:
            found |= _of_group(episodes, name, where.stop - where.start)
    if episodes.task.goal is not None:
        place = Measurement((3,), "m", "wanted position of the tip, world frame", lambda o, row: o.target.tip_pose[row, 0, :3, 3])
        found |= {**_tip_pose(), "target_position": place}
    return found


def _of_group(episodes: Episodes, name: str, size: int) -> dict[str, Measurement]:
    group = group_of(episodes, name)
    if own_group(episodes, name) or name not in (*STATES, *POSES, LENGTHS):
        unit = UNITS.get(name, "the group's own")
        return {name: Measurement((size,), unit, group.description, lambda o, row: group.values(o)[row])}
    if name in ("target_error", "preview"):
        return {**_tip_pose(), "target_pose": _target_pose(episodes)}
    if name == LENGTHS:
        wanted = Measurement((size,), "m", "tendon displacements of the target", lambda o, row: o.target_length[row])
        return {**_of_group(episodes, "tendon_lengths", size), LENGTHS: wanted}
    return _tip_pose() if name in POSES else {}


def _tip_pose() -> dict[str, Measurement]:
    text = "homogeneous transform of the tip, world frame"
    return {"tip_pose": Measurement((4, 4), "1, last column m", text, lambda o, row: o.tip_pose[row])}


def _target_pose(episodes: Episodes) -> Measurement:
    times = ", ".join(f"{time:g}" for time in episodes.ahead)
    text = f"homogeneous transforms that are wanted of the tip, world frame, {times} s from now"
    return Measurement((len(episodes.ahead), 4, 4), "1, last column m", text, lambda o, row: o.target.tip_pose[row])
