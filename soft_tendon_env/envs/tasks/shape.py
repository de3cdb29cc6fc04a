"""Shape control: take the shapes in which given tensions hold the arm."""

from soft_tendon_env.envs.tasks import TIP, Task, register_task
from soft_tendon_env.envs.tracking import BACKBONE, COORDINATES, POSITION

SHAPE = register_task(
    Task(
        name="Shape",
        description="""
## Description
A soft arm, pulled by tendons, is to take a sequence of shapes: those in which given tensions would hold it at rest (shape
control of Mathew, Renda et al., RA-L 2024, Section IV-A).

## Action Space
As `TipPoseEnv`.

## Observation Space
As `TipPoseEnv`, with the groups

| group | size | what |
|---|---|---|
| coordinates | n | generalised coordinates |
| rates | n | their rates |
| tip_position | 3 | tip position over the rod's length |
| tip_rotation | 6 | first two columns of the tip's rotation matrix |
| target_coordinates | n | coordinates of the target less the arm's |
| coordinate_preview | n p | the same at each preview time |
| last_action | n_a | the last action |

## Rewards
As `TipPoseEnv`, with the term `backbone` (root mean square distance between backbone and target, scale 0.05 m) in place of
`position` and `angle`; also `coordinates` (norm of the coordinates' error) and `position` may be given weights.

## Starting State
As `TipPoseEnv`. `target="ramp"` is the paper's: from rest to static tensions within 2.5 s, then held.

## Episode End
As `TipPoseEnv`.

## Arguments
As `TipPoseEnv`. A target must be made of tensions.

## Version History
* v0: initial version
""",
        target="random",
        observations={
            "full": ("coordinates", "rates", *TIP, "target_coordinates", "coordinate_preview", "last_action"),
            "measurable": (*TIP, "tendon_lengths", "strain", "target_error", "target_lengths", "preview", "last_action"),
        },
        errors=(BACKBONE, COORDINATES, POSITION),
        reward={"backbone": 1.0, "effort": 0.05, "smoothness": 0.05},
        reference=("target_coordinates", "coordinate_preview"),
        measured=(*TIP, "strain", "strain_rate", "target_error", "preview", "wanted_coordinates"),
        shapes=True,
    )
)
