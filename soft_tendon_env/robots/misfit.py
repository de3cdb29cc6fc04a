"""Reasons why a robot cannot play an environment's episodes, each with what to do."""

from soft_tendon_env.envs.episodes import Episodes
from soft_tendon_env.envs.observation import HISTORY
from soft_tendon_env.envs.tasks import TIP
from soft_tendon_env.policies.estimators import PARAMETERS
from soft_tendon_env.policies.regimes import TARGET_GROUPS, TARGET_GROUPS_BY_CHOICE
from soft_tendon_env.robots.protocol import Robot

FIELDS = {**dict.fromkeys(TIP, "tip_pose"), **PARAMETERS}
"""Fields of Measurement that observation groups need, by group."""

COORDINATES = ("q", "q_dot")
"""Fields that no sensor measures."""


def misfit(robot: Robot, episodes: Episodes) -> str:
    """Reason why a robot cannot play an environment's episodes; "": it can."""
    unit = episodes.model.command_unit
    if robot.command_unit != unit:
        return (
            f"which takes {robot.command_unit!r}, and the scene's arm takes {unit!r}: see"
            " [effects.tendon_elasticity]"
        )
    drawn = episodes.options.randomize
    if drawn.numbers or drawn.of_actuators or drawn.latency != (0.0, 0.0):
        return (
            "as it is: the option randomize should have no more than the noise of its sensors, for"
            " policies that know of it"
        )
    missing = _missing_senses(robot, episodes)
    if missing:
        return missing
    if episodes.task.shapes:
        return "measured at its tip and by its sensors alone"
    known = {*FIELDS, *TARGET_GROUPS, *TARGET_GROUPS_BY_CHOICE, HISTORY}
    unknown = [name for name in episodes.layout.slices if name not in known]
    if unknown:
        return f"measured at its tip and by its sensors alone: not {', '.join(unknown)}"
    return ""


def _missing_senses(robot: Robot, episodes: Episodes) -> str:
    """Fields that a robot does not sense and an environment needs, and what to do; "": none."""
    groups = [name for name in episodes.layout.slices if name != HISTORY]
    # fields that a robot has to sense, and what for
    needed = {FIELDS[name]: name for name in groups if name in FIELDS}
    needed["tip_pose"] = "the errors of the task"
    if episodes.options.tip_speed_limit is not None:
        needed["tip_twist"] = "the option tip_speed_limit"
    missing = [field for field in needed if field not in robot.senses]
    if not missing:
        return ""
    reasons = (f"{field} ({needed[field]})" for field in missing)
    named = ", ".join(reasons)
    if "tip_pose" in missing:
        return f"without {named}: every run needs a tracker of the tip's pose"
    if needed.get("tip_twist") == "the option tip_speed_limit" and "tip_twist" in missing:
        return f"without {named}: leave that option out"
    left = [name for name in groups if FIELDS.get(name) not in missing]
    quoted = (f"'{name}'" for name in left)
    listed = ",".join(quoted)
    text = f'without {named}, which is observed: take it out, by --set "observation=[{listed}]"'
    if set(COORDINATES) & set(missing):
        text += (
            ". No sensor measures coordinates: a controller NAME runs as filtered:NAME, which"
            " estimates them"
        )
    return text
