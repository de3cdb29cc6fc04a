"""Tendon routings and tapers: slopes against differences, the formulas of each, and what they
refuse."""

import numpy as np
import pytest

from soft_tendon_env.scene.routing import (
    ConvergingRouting,
    HelixRouting,
    LinearTaper,
    StraightRouting,
    SurfaceRouting,
    TableRouting,
    TaperTable,
)
from soft_tendon_env.scene.sections import Ellipse, Rectangle
from soft_tendon_env.tools.configuration import ConfigurationError

ENDS = (0.1, 0.5)
LENGTH = 0.4
RADII = TaperTable(arc_length=(0.0, 0.1, 0.25, 0.4), size=(0.02, 0.018, 0.01, 0.012))
ROUTINGS = {
    "straight": StraightRouting(offset=(0.01, -0.02)),
    "converging": ConvergingRouting(start_offset=(0.02, 0.0), end_offset=(0.01, 0.01)),
    "surface": SurfaceRouting(fraction=0.8, angle=40.0),
    "helix": HelixRouting(radius=0.01, angular_rate=-12.0, phase=25.0),
    "table": TableRouting(
        arc_length=(0.0, 0.2, 0.3, 0.4, 0.6),
        y=(0.01, 0.02, 0.0, -0.01, 0.0),
        z=(0.0, 0.0, 0.01, 0.02, 0.01),
    ),
}


def evaluate(routing, arc_length):
    radius = 0.03 - 0.02 * arc_length + 0.01 * arc_length**2
    return routing.offset_and_slope(arc_length, radius, -0.02 + 0.02 * arc_length, ENDS)


@pytest.mark.parametrize("routing", ROUTINGS.values(), ids=ROUTINGS)
def test_slope_is_the_derivative_of_the_offset(routing):
    x = np.linspace(0.11, 0.49, 41)
    h = 1e-6
    offset, slope = evaluate(routing, x)
    assert offset.shape == slope.shape == (41, 2)
    np.testing.assert_allclose(
        slope, (evaluate(routing, x + h)[0] - evaluate(routing, x - h)[0]) / (2 * h), atol=1e-8
    )


@pytest.mark.parametrize("shape", [Rectangle, Ellipse])
@pytest.mark.parametrize("angle", [0.0, 20.0, 75.0, 90.0, -130.0])
def test_a_tendon_on_the_surface_of_a_flat_section_lies_on_its_outline(shape, angle):
    """As the section tapers, the slope follows."""
    section = shape(
        width=LinearTaper(base=0.03, tip=0.02),
        height=TaperTable(arc_length=(0, 0.4), size=(0.008, 0.006)),
    )
    x = np.linspace(0.01, 0.39, 21)
    h = 1e-6
    routing = SurfaceRouting(angle=angle)

    def offset_and_slope(places):
        radius, slope = section.outline_radius(routing.direction, places, LENGTH)
        return routing.offset_and_slope(places, radius, slope, ENDS)

    offset, slope = offset_and_slope(x)
    half_widths = 0.5 * section.hull(x, LENGTH)[:2].T
    y, z = np.abs(offset / half_widths).T
    if shape is Rectangle:
        extent = np.maximum(y, z)
    else:
        extent = np.hypot(y, z)
    np.testing.assert_allclose(extent, 1.0, rtol=1e-12)
    np.testing.assert_allclose(np.arctan2(*offset.T[::-1]), np.deg2rad(angle), atol=1e-12)
    ahead, _ = offset_and_slope(x + h)
    behind, _ = offset_and_slope(x - h)
    expected_slope = (ahead - behind) / (2 * h)
    np.testing.assert_allclose(slope, expected_slope, atol=1e-8)


@pytest.mark.parametrize("profile", [LinearTaper(base=0.03, tip=0.02), RADII])
def test_slope_is_the_derivative_of_the_radius(profile):
    s = np.linspace(0.011, 0.389, 50)
    h = 1e-6
    ahead, _ = profile.size_and_slope(s + h, LENGTH)
    behind, _ = profile.size_and_slope(s - h, LENGTH)
    np.testing.assert_allclose(
        profile.size_and_slope(s, LENGTH)[1], (ahead - behind) / (2 * h), atol=1e-7
    )


def test_radii_meet_their_points_and_never_overshoot():
    np.testing.assert_allclose(
        RADII.size_and_slope(np.array(RADII.arc_length), LENGTH)[0], RADII.size, rtol=1e-14
    )
    radius, _ = RADII.size_and_slope(np.linspace(0, LENGTH, 500), LENGTH)
    assert radius.min() >= 0.01
    assert radius.max() <= 0.02


def test_misfits_say_what_is_wrong():
    assert "should cover the tendon, 0.1 to 0.7, but its arc_length runs from 0 to 0.6" in ROUTINGS[
        "table"
    ].misfit((0.1, 0.7))


@pytest.mark.parametrize(
    ("kind", "columns", "message"),
    [
        (
            TaperTable,
            {"arc_length": (0.0,), "radius": (0.1,)},
            r"arc_length is \[0.0\]: it should have at least 2 items, not 1",
        ),
        (TaperTable, {"arc_length": (0.2, 0.1), "radius": (0.1, 0.1)}, "it should increase"),
        (
            TaperTable,
            {"arc_length": (0.0, 0.2), "radius": (0.1, 0.0)},
            r"radius\[1\] is 0.0: it should be greater than 0",
        ),
        (
            TableRouting,
            {"arc_length": (0.0, 0.2, 0.1, 0.3), "y": (0.0,) * 4, "z": (0.0,) * 4},
            "arc_length is .*: it should increase",
        ),
        (
            TableRouting,
            {"arc_length": (0, 0.1, 0.2, 0.3), "y": (0.0,) * 4, "z": (0.0, 0.0)},
            "z is .*: it should have one entry per arc",
        ),
    ],
)
def test_tables_refuse(kind, columns, message):
    with pytest.raises(ConfigurationError, match=message):
        kind(**columns)
