"""A wrench at the tip, and a payload fixed to it."""
from typing import Annotated, Literal

from pydantic import Field

from soft_tendon_env.effects import Effect, register

Vector = tuple[float, float, float]
NotNegative = Annotated[float, Field(ge=0)]


@register("tip_load")
class TipLoad(Effect):
    """`[effects.tip_load]`.

    `force` (x, y, z) [N] and `moment` (x, y, z) [N m] act at the tip, with components in `frame`: "world" (a dead load)
    or "tip" (a load that follows the tip). `mass` [kg] and `inertia` (principal moments about the tip frame's axes)
    [kg m^2] belong to a payload whose centre of mass is the tip frame's origin.
    """

    force: Vector = (0.0, 0.0, 0.0)
    moment: Vector = (0.0, 0.0, 0.0)
    frame: Literal["world", "tip"] = "world"
    mass: NotNegative = 0.0
    inertia: tuple[NotNegative, NotNegative, NotNegative] = (0.0, 0.0, 0.0)
