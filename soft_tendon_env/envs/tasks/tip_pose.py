"""Tip pose tracking: carry the tip along a moving pose."""

from soft_tendon_env.envs.tasks import TIP, Task, register_task
from soft_tendon_env.envs.tracking import ANGLE, POSITION

TIP_POSE = register_task(
    Task(
        name="TipPose",
        description="""
## Description
A soft arm, pulled by tendons, is to carry its tip along a moving pose. The arm is a Cosserat rod with the statics-based
reduced dynamics of Mathew, Renda et al. (RA-L 2024); by default the paper's arm of 1 m with ten tendons.

## Action Space
`Box(-1, 1, (n_a,), float32)`, one entry per tendon, clipped to that. With `action="tension"` -1 is the least and 1 the greatest
tension (by default those of the scene, 0 to 60 N on the paper's arm: tendons pull), with "increment" the largest change down or up.

## Observation Space
`Box(float32)` of the groups below side by side, each scaled to about 1 and clipped to ±10 (ways to the target: ±100), for n
coordinates, n_a tendons, p preview times; `observation` chooses others (see docs/reference/environments.md).

| group | size | what |
|---|---|---|
| coordinates | n | generalised coordinates |
| rates | n | their rates |
| tip_position | 3 | tip position over the rod's length |
| tip_rotation | 6 | first two columns of the tip's rotation matrix |
| tip_twist | 6 | tip twist, angular then linear |
| target_error | 6 | SE(3) logarithm from tip to target, angular then linear |
| target_twist | 6 | twist of the target |
| preview | 6 p | SE(3) logarithm from tip to the target at each preview time |
| last_action | n_a | the last action |

## Rewards
The weighted mean of terms between 0 and 1, so between 0 and 1 itself; 0 where the simulation diverged. Each term is in `info` as
`reward_<term>`: `position` and `angle`, 1 / (1 + (error / scale)^2) with scales 0.05 m and 0.5 rad; `effort`, 1 less the mean
square tension; `smoothness`, 1 less the mean square change of the action. Weights 1, 0.5, 0.05, 0.05.

## Starting State
At rest under the tensions nearest to zero. The target is drawn: by default a closed smooth random motion that the statics can follow.

## Episode End
Truncated after 500 steps (10 s). Terminated if no time step of the simulation succeeds, however small: `info["diverged"]` is true
and `info["cause"]` says why, the observation is the last good one.

## Arguments
All of `soft_tendon_env.envs.Options`: `scene`, `fidelity`, `target`, `observation`, `reward`, `randomize`, ...

## Version History
* v0: initial version
""",
        target="random",
        observations={
            "full": ("coordinates", "rates", *TIP, "tip_twist", "target_error", "target_twist", "preview", "last_action"),
            "measurable": (*TIP, "tendon_lengths", "strain", "target_error", "target_twist", "preview", "last_action"),
        },
        errors=(POSITION, ANGLE),
        reward={"position": 1.0, "angle": 0.5, "effort": 0.05, "smoothness": 0.05},
        reference=("target_error", "preview"),
        measured=(*TIP, "strain", "strain_rate", "target_error", "preview"),
    )
)
