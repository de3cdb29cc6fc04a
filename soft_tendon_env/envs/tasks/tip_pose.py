"""Tip pose tracking: carry the tip along a moving pose."""

from soft_tendon_env.envs.tasks import TIP, Task, register_task
from soft_tendon_env.envs.tracking import ANGLE, POSITION

TIP_POSE = register_task(
    Task(
        name="TipPose",
        description="""
## Description
The policy moves the tip of a tendon-driven soft arm along a moving pose: position and orientation. The arm is a Cosserat rod
with the statics-based reduced dynamics of Mathew, Renda et al. (RA-L 2024). The default arm is the paper's, 1 m long with ten
tendons.

## Action Space
`Box(-1, 1, (n_a,), float32)` has one entry per tendon; larger values are clipped. With `action="tension"`, -1 and 1 are the
smallest and the largest tension, 0 and 60 N on the default arm: tendons pull and do not push. With `action="increment"`, -1 and 1
are the largest decrease and increase of a tension in one control period.

## Observation Space
`Box(float32)` holds groups side by side: coordinates, rates, tip_position, tip_rotation, tip_twist, target_error, target_twist,
preview, last_action. Each is scaled to about 1 and clipped to ±10, the two errors of the target to ±100. The option `observation`
chooses others, see docs/reference/environments.md.

## Rewards
The reward is a weighted mean of terms between 0 and 1, and 0 where the simulation diverged. `info` has each term as
`reward_<term>`.

- `position` (weight 1) and `angle` (0.5) are 1 / (1 + (error / scale)^2), with scales of 0.05 lengths of the rod and 0.5 rad.
- `effort` (0.05) is 1 minus the mean square tension, as a share of the limits.
- `smoothness` (0.05) is 1 minus a quarter of the mean square change of the action.

## Starting State
The arm rests under the tensions nearest to zero. The target is drawn at every reset. By default it is a closed smooth random motion
through poses that the arm can hold. `reset(options=...)` sets both.

## Episode End
An episode is truncated after 500 steps, 10 s at the default control period, unless `gym.make` is given `max_episode_steps`. It
is terminated if no time step of the simulation succeeds, however small. Then `info["diverged"]` is true, `info["cause"]` says
why, and the observation is the last good one.

## Arguments
Every environment takes the keyword arguments of `soft_tendon_env.envs.Options`.
""",
        target="random",
        observations={
            "full": ("coordinates", "rates", *TIP, "tip_twist", "target_error", "target_twist", "preview", "last_action"),
            "measurable": (*TIP, "tendon_lengths", "strain", "target_error", "target_twist", "preview", "last_action"),
        },
        errors=(POSITION, ANGLE),
        reward={"position": 1.0, "angle": 0.5, "effort": 0.05, "smoothness": 0.05},
        reference=("target_error", "preview"),
        measured_reference=("target_error", "preview"),
    )
)
