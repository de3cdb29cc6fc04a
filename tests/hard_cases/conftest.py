"""What the hard cases share: arms with one segment, motions to compare, and the measured numbers
for docs/appendix/hard_cases.md."""

import numpy as np
import pytest

from soft_tendon_env.model.build import build_model
from soft_tendon_env.scene.routing import StraightRouting
from soft_tendon_env.scene.scene import Scene, Segment, Tendon


@pytest.fixture
def measured(request):
    """measured("tip error [mm]", 0.3): a number for the table."""

    def note(what: str, value: float) -> None:
        request.node.user_properties.append((what, float(value)))

    return note


@pytest.fixture(scope="session")
def straight_tendons():
    """straight_tendons((y, z), (y, z, end), ...): tendons parallel to the axis [m]."""

    def tendons(*offsets):
        return [
            Tendon(
                routing=StraightRouting(offset=(float(y), float(z))),
                end=float(end[0]) if end else None,
            )
            for y, z, *end in offsets
        ]

    return tendons


@pytest.fixture(scope="session")
def one_segment(straight_tendons):
    """one_segment(tendons=..., changes={...}, length=..., ...): the model of a uniform arm, by
    default with three tendons."""

    def build(
        *,
        length=1.0,
        radius=0.02,
        young_modulus=1e6,
        density=1000.0,
        damping=1e4,
        curvature=(0, 0, 0),
        tendons=None,
        changes=None,
    ):
        segment = Segment(
            length=length,
            radius=radius,
            young_modulus=young_modulus,
            density=density,
            damping=damping,
            poisson_ratio=0.5,
            curvature=tuple(float(k) for k in curvature),
        )
        if tendons is None:
            tendons = straight_tendons(
                *(
                    (0.8 * radius * np.cos(a), 0.8 * radius * np.sin(a))
                    for a in 2 * np.pi * np.arange(3) / 3
                )
            )
        return build_model(
            Scene(name="uniform", segments=[segment], tendons=tendons).replace(changes or {})
        )

    return build


@pytest.fixture(scope="session")
def one_pulled():
    """one_pulled(model, tendon, tension): all tendons slack but one [N]."""

    def tension(model, tendon, value):
        return np.where(np.arange(model.tendon_count) == tendon, float(value), 0.0)

    return tension


@pytest.fixture(scope="session")
def tip_distance():
    """tip_distance(a, b): the largest distance [m] between the tips of two poses (4, 4), or of two
    tracks of poses (samples, 4, 4)."""
    return lambda a, b: float(np.linalg.norm(a[..., :3, 3] - b[..., :3, 3], axis=-1).max())
