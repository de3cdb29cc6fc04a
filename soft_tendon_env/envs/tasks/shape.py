"""Shape control: take the shapes in which given tensions hold the arm."""

from soft_tendon_env.envs.tasks import TIP, Task, register_task
from soft_tendon_env.envs.tracking import BACKBONE, COORDINATES, POSITION

SHAPE = register_task(
    Task(
        name="Shape",
        description="""
## Description
The policy moves the whole arm through a sequence of shapes: the static equilibria under given tensions (shape control of Mathew,
Renda et al., RA-L 2024, Section IV-A). Actions, episode end and arguments are those of `TipPoseEnv`. The target must be defined by
tensions; with `target="ramp"` it is the paper's: tensions rise from rest for 2.5 s and are then held.

## Observation Space
`Box(float32)` holds groups side by side: coordinates, rates, tip_position, tip_rotation, target_coordinates, coordinate_preview,
last_action. See docs/reference/environments.md.

## Rewards
As in `TipPoseEnv`, with the term `backbone` (weight 1) in place of `position` and `angle`. Its error is the root mean square
distance between the backbone and the target, with a scale of 0.05 lengths of the rod. `coordinates` (norm of the coordinates'
error) and `position` are further terms, with weight 0 by default.
""",
        target="random",
        observations={
            "full": ("coordinates", "rates", *TIP, "target_coordinates", "coordinate_preview", "last_action"),
            "measurable": (*TIP, "tendon_lengths", "strain", "target_error", "target_lengths", "preview", "last_action"),
        },
        errors=(BACKBONE, COORDINATES, POSITION),
        reward={"backbone": 1.0, "effort": 0.05, "smoothness": 0.05},
        reference=("target_coordinates", "coordinate_preview"),
        measured_reference=("target_error", "preview", "wanted_coordinates"),
        shapes=True,
    )
)
