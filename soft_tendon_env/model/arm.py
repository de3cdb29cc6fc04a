"""Arrays of an arm that the kernels read: rod, tendons, strain and effects of a scene on a grid."""

import numpy as np

from soft_tendon_env.mechanics.algebra.lanes import aligned_copy
from soft_tendon_env.mechanics.effects import EffectTable
from soft_tendon_env.mechanics.types import Arm, Explicit, Implicit, Loaded, StaticsBased
from soft_tendon_env.model.coordinates import effects_inside, effects_outside, make_strain
from soft_tendon_env.model.grid import Grid, StressFreeArm, at_points, make_rod
from soft_tendon_env.scene.scene import Scene
from soft_tendon_env.tools.configuration import ConfigurationError, Problem


def make_arm(
    scene: Scene, grid: Grid, strain: StaticsBased | Loaded | Explicit | None = None
) -> Arm:
    """All that the kernels read of a scene, on this grid.

    Args:
        scene: of the arm.
        grid: of the scene's rod.
        strain: with the combinations of tensions and the passive fields that stay; None: they are
            made anew.

    Raises:
        ConfigurationError: for loads inside of the strain of an arm whose base moves.
    """
    stress_free = at_points(scene, grid)
    effects = _effect_table(scene, stress_free)
    law = None
    if isinstance(strain, Implicit):
        law = strain.law
    pose = scene.base.pose
    return Arm(
        base=aligned_copy(np.append(pose[:3, :3], pose[:3, 3])),
        rod=make_rod(scene, grid, stress_free),
        tendons=stress_free.tendons,
        strain=make_strain(scene, grid, stress_free, law),
        effects=effects,
    )


def with_every_tension(arm: Arm) -> Arm:
    """The arm with a coordinate for every tension, those of redundant tendons too.

    It can be placed, and not moved.
    """
    strain = arm.strain
    assert not isinstance(strain, Explicit)
    count = arm.tendons.size
    passive_count = strain.law.size - strain.law.active
    size = count + passive_count
    packs = np.full(size, arm.rod.packs)
    everywhere = {
        "size": size,
        "pack_begin": np.zeros(size, dtype=np.int64),
        "pack_end": packs,
        "jacobian_end": packs,
    }
    law = strain.law.replaced(
        **everywhere,
        row_start=np.arange(count + 1),
        column=np.arange(count),
        weight=np.ones(count),
        mixed=0,
        active=count,
    )
    if isinstance(strain, Loaded):
        loaded = strain.replaced(**everywhere, law=law)
        return arm.replaced(strain=loaded)
    return arm.replaced(strain=law)


def _effect_table(scene: Scene, stress_free: StressFreeArm) -> EffectTable:
    """The effects outside of the strain, as the kernels read them."""
    effects = effects_outside(scene).table(stress_free.rod)
    if effects.base.any() and effects_inside(scene):
        text = (
            "is given, but the loads inside of a strain have to stand still beside the arm's base,"
            " which moves: leave it out"
        )
        raise ConfigurationError([Problem(("strain", "include_loads"), text)])
    return effects
