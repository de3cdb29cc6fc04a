"""Reaching: bring the tip to a point; goal-conditioned, for hindsight experience replay."""

from soft_tendon_env.envs.tasks import TIP, Task, register_task
from soft_tendon_env.envs.tracking import POSITION

REACH = register_task(
    Task(
        name="Reach",
        description="""
## Description
The policy brings the tip of a tendon-driven soft arm to a point. The task is goal-conditioned, for hindsight experience replay
(HER). Actions, starting state, episode end and arguments are those of `TipPoseEnv`, with the argument `threshold`.

## Observation Space
`Dict` with three entries. `observation` has the groups coordinates, rates, tip_position, tip_rotation, tip_twist, last_action.
`achieved_goal` and `desired_goal` are tip positions in metres, `Box((3,), float32)`.

## Rewards
`reward="sparse"` is 1 within `threshold` (0.01 lengths of the rod) of the goal, else 0. `reward="dense"` is
1 / (1 + (distance / (5 threshold))^2). `compute_reward(achieved_goal, desired_goal, info)` gives the same for many goals.

## Starting State
The goal is drawn: it is the tip's position at rest under random tensions. One within `threshold` of where the tip begins is drawn
again; a goal that is given stays. Reaching it does not end the episode; `info["is_success"]` says whether the tip is there.
""",
        target="hold",
        observations={
            "full": ("coordinates", "rates", *TIP, "tip_twist", "last_action"),
            "measurable": (*TIP, "tendon_lengths", "strain", "last_action"),
        },
        errors=(POSITION,),
        goal="tip position",
    )
)
