"""Reaching: bring the tip to a point; goal-conditioned, for hindsight experience replay."""

from soft_tendon_env.envs.rewards import TipGoal
from soft_tendon_env.envs.tasks import TIP, Task, register_task
from soft_tendon_env.envs.tracking import POSITION

REACH = register_task(
    Task(
        name="Reach",
        description="""
## Description
A soft arm, pulled by tendons, is to bring its tip to a point: goal-conditioned, for hindsight experience replay.

## Action Space
As `TipPoseEnv`.

## Observation Space
`Dict` of `observation` (as `TipPoseEnv`: coordinates, rates, tip_position, tip_rotation, tip_twist, last_action), `achieved_goal` and
`desired_goal`, both tip positions in metres, `Box((3,), float32)`.

## Rewards
`reward="sparse"`: 1 within `threshold` (10 mm) of the goal, else 0. `reward="dense"`: 1 / (1 + (distance / (5 threshold))^2).
`compute_reward(achieved_goal, desired_goal, info)` gives the same for many.

## Starting State
As `TipPoseEnv`. The goal is drawn: the tip's position at rest under random tensions.

## Episode End
As `TipPoseEnv`; reaching the goal does not end the episode. `info["is_success"]` says whether it is reached now.

## Arguments
As `TipPoseEnv`, and `threshold`.

## Version History
* v0: initial version
""",
        target="hold",
        observations={
            "full": ("coordinates", "rates", *TIP, "tip_twist", "last_action"),
            "measurable": (*TIP, "tendon_lengths", "strain", "last_action"),
        },
        errors=(POSITION,),
        measured=(*TIP, "strain", "strain_rate"),
        goal=TipGoal(),
    )
)
