"""Tendon routings: slopes against differences, the formulas of each, and what they refuse."""

import numpy as np
import pytest

from soft_tendon_env.scene.routing import ConvergingRouting, HelixRouting, StraightRouting, SurfaceRouting, TableRouting
from soft_tendon_env.tools.configuration import ConfigurationError

ENDS = (0.1, 0.5)
ROUTINGS = {
    "straight": StraightRouting(offset=(0.01, -0.02)),
    "converging": ConvergingRouting(start_offset=(0.02, 0.0), end_offset=(0.01, 0.01)),
    "surface": SurfaceRouting(fraction=0.8, angle=40.0),
    "helix": HelixRouting(radius=0.01, angular_rate=-12.0, phase=25.0),
    "table": TableRouting(arc_length=(0.0, 0.2, 0.3, 0.4, 0.6), y=(0.01, 0.02, 0.0, -0.01, 0.0), z=(0.0, 0.0, 0.01, 0.02, 0.01)),
}


def evaluate(routing, arc_length):
    radius = 0.03 - 0.02 * arc_length + 0.01 * arc_length**2
    return routing.offset_and_slope(arc_length, radius, -0.02 + 0.02 * arc_length, ENDS)


@pytest.mark.parametrize("name", ROUTINGS)
def test_slope_is_the_derivative_of_the_offset(name):
    x, h = np.linspace(0.11, 0.49, 41), 1e-6
    offset, slope = evaluate(ROUTINGS[name], x)
    assert offset.shape == slope.shape == (41, 2)
    difference = (evaluate(ROUTINGS[name], x + h)[0] - evaluate(ROUTINGS[name], x - h)[0]) / (2 * h)
    np.testing.assert_allclose(slope, difference, atol=1e-8)


def test_surface_follows_the_radius():
    offset, _ = evaluate(SurfaceRouting(angle=90.0), np.array([0.0, 0.1]))
    np.testing.assert_allclose(offset, [(0.0, 0.03), (0.0, 0.0281)], atol=1e-16)


def test_helix_turns_from_y_to_z():
    offset, _ = evaluate(HelixRouting(radius=0.01, angular_rate=np.pi), np.array([0.0, 0.5]))
    np.testing.assert_allclose(offset, [(0.01, 0.0), (0.0, 0.01)], atol=1e-16)


def test_table_meets_its_points_and_reproduces_a_cubic():
    x = np.array([0.0, 0.2, 0.3, 0.4, 0.6])
    cubic = TableRouting(arc_length=x, y=x**3, z=x - x**2)
    fine = np.linspace(0.0, 0.6, 30)
    offset, slope = evaluate(cubic, fine)
    np.testing.assert_allclose(offset, np.column_stack([fine**3, fine - fine**2]), atol=1e-15)
    np.testing.assert_allclose(slope, np.column_stack([3 * fine**2, 1 - 2 * fine]), atol=1e-14)


def test_misfits_say_what_is_wrong():
    assert "should cover the tendon, 0.1 to 0.7, but its arc_length runs from 0 to 0.6" in ROUTINGS["table"].misfit((0.1, 0.7))
    late = ConvergingRouting(start_offset=(0.02, 0.0), end_offset=(0.01, 0.01), start=0.5)
    assert "start < end, but they are 0.5 and 0.4" in late.misfit((0.0, 0.4))


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"arc_length": (0.0, 0.1, 0.2)}, "arc_length is .*: it should have at least 4 items, not 3"),
        ({"arc_length": (0.0, 0.2, 0.1, 0.3)}, "arc_length is .*: it should increase"),
        ({"z": (0.0, 0.0)}, "z is .*: it should have one entry per arc_length, 4"),
    ],
)
def test_table_refuses(change, message):
    good = {"arc_length": (0.0, 0.1, 0.2, 0.3), "y": (0.0,) * 4, "z": (0.0,) * 4}
    with pytest.raises(ConfigurationError, match=message):
        TableRouting(**{**good, **change})
