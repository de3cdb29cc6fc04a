"""Radius profiles: values, slopes against differences, and what they refuse."""

import numpy as np
import pytest

from soft_tendon_env.scene.radius import LinearRadius, RadiusTable, radius_and_slope
from soft_tendon_env.tools.configuration import ConfigurationError

LENGTH = 0.4
TABLE = RadiusTable(arc_length=(0.0, 0.1, 0.25, 0.4), radius=(0.02, 0.018, 0.01, 0.012))
PROFILES = {"number": 0.01, "linear": LinearRadius(base=0.03, tip=0.02), "table": TABLE}


@pytest.mark.parametrize("name", PROFILES)
def test_slope_is_the_derivative_of_the_radius(name):
    s, h = np.linspace(0.011, 0.389, 50), 1e-6
    _, slope = radius_and_slope(PROFILES[name], s, LENGTH)
    ahead, behind = (radius_and_slope(PROFILES[name], s + d, LENGTH)[0] for d in (h, -h))
    np.testing.assert_allclose(slope, (ahead - behind) / (2 * h), atol=1e-7)


def test_table_meets_its_points_and_never_overshoots():
    np.testing.assert_allclose(radius_and_slope(TABLE, TABLE.arc_length, LENGTH)[0], TABLE.radius, rtol=1e-14)
    radius, _ = radius_and_slope(TABLE, np.linspace(0, LENGTH, 500), LENGTH)
    assert radius.min() >= 0.01 and radius.max() <= 0.02


@pytest.mark.parametrize(
    ("arc_length", "radius", "message"),
    [
        ((0.0,), (0.1,), r"arc_length is \[0.0\]: it should have at least 2 items, not 1"),
        ((0.1, 0.2), (0.1, 0.1), r"arc_length is \[0.1, 0.2\]: it should start at 0 and increase"),
        ((0.0, 0.2, 0.2), (0.1, 0.1, 0.1), "should start at 0 and increase"),
        ((0.0, 0.2), (0.1, 0.1, 0.1), r"radius is \[0.1, 0.1, 0.1\]: it should have one entry per arc_length, 2"),
        ((0.0, 0.2), (0.1, 0.0), r"radius\[1\] is 0.0: it should be greater than 0"),
    ],
)
def test_table_refuses(arc_length, radius, message):
    with pytest.raises(ConfigurationError, match=message):
        RadiusTable(arc_length=arc_length, radius=radius)
