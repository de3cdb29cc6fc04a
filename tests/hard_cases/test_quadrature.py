"""What varies along the rod faster than the quadrature's intervals: routings, radii, fields,
curvature.

The strain is known at two points of every interval. Whatever turns between them is missed, and the
numbers look no worse for it.
"""

import warnings

import numpy as np
import pytest

import soft_tendon_env as ste
from soft_tendon_env.model.build import QuadratureWarning
from soft_tendon_env.model.quadrature import QuadratureTest
from soft_tendon_env.scene.scene import TIP_TOLERANCE

ALONG = np.linspace(0.0, 0.3, 61)
ANGULAR = ["torsion", "bend_y", "bend_z"]


def helices(turns, radius=0.008):
    routings = (
        {
            "type": "helix",
            "radius": radius,
            "angular_rate": 2 * np.pi * turns / 0.3,
            "phase": 120.0 * i,
        }
        for i in range(3)
    )
    return {f"tendons.{i}.routing": routing for i, routing in enumerate(routings)}


@pytest.fixture
def compared(measured, tip_distance):
    """compared(changes): tip errors [m] of three_tendon with these changes, on 6 intervals and on
    those that it gets, under its tendons pulled alone, in pairs and together; and noted."""

    def compare(changes):
        scene = ste.load_scene("three_tendon").replace(changes)
        limits = [tendon.tension_limits[1] for tendon in scene.tendons]
        tensions = np.indices((2, 2, 2)).reshape(3, -1).T * limits
        model = ste.build_model(scene)
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            coarse = ste.build_model(scene.replace({"quadrature.intervals": 6}))
        fine = ste.build_model(
            scene.replace({"quadrature.intervals": min(4 * model.grid.per_piece, 512)})
        )
        exact = [ste.static_equilibrium(fine, tension) for tension in tensions]
        errors = []
        for arm in (coarse, model):
            found = [
                ste.static_equilibrium(arm, tension, near.q)
                for tension, near in zip(tensions, exact, strict=True)
            ]
            assert all(rest.converged for rest in found + exact)
            errors.append(
                max(
                    tip_distance(rest.tip_pose, near.tip_pose)
                    for rest, near in zip(found, exact, strict=True)
                )
            )
        measured("intervals", model.grid.per_piece)
        measured("tip error [mm]", 1e3 * errors[1])
        measured("on 6 intervals [mm]", 1e3 * errors[0])
        measured("estimated for 6 [mm]", 300.0 * QuadratureTest(scene).error_estimate(6).error)
        return errors[0], errors[1], scene

    return compare


def told(scene):
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        ste.build_model(scene.replace({"quadrature.intervals": 6}))
    return [str(warning.message) for warning in caught if warning.category is QuadratureWarning]


@pytest.mark.parametrize("turns", [3, 6, 12])
def test_helical_tendons(compared, turns):
    """Helices of 3, 6 and 12 turns: on 6 intervals those of 6 and 12 turns look like straight
    tendons, which bend the arm. Expected: without a number given, as many intervals as keep the tip
    within 0.25 % of the length; 6 given are told to be too few."""
    coarse, error, scene = compared(helices(turns))
    assert coarse > 0.3 * 3 * TIP_TOLERANCE
    assert error < 0.3 * TIP_TOLERANCE
    (message,) = told(scene)
    assert "under tensions" in message
    assert "would do" in message


@pytest.mark.slow
@pytest.mark.parametrize("turns", [13, 26, 39, 52])
def test_helices_that_two_quadratures_see_alike(compared, turns):
    """As many turns as another quadrature has intervals, or a multiple: on that one they look
    straight too: two agree and are wrong. Expected: the tip within the tolerance; the error on 6
    intervals is noticed."""
    coarse, error, scene = compared(helices(turns))
    assert error < 0.3 * TIP_TOLERANCE
    assert coarse < 0.3 * TIP_TOLERANCE or told(scene)


@pytest.mark.parametrize("waves", [4, 8, 16])
def test_a_tendon_that_waves(compared, waves):
    """A tendon through a table of points that sways by 2 mm, 4 to 16 times along the arm. Expected:
    the tip within the tolerance; the error on 6 intervals is noticed."""
    y = 0.006 + 0.002 * np.sin(2 * np.pi * waves * ALONG / 0.3)
    coarse, error, scene = compared(
        {"tendons.0.routing": {"type": "table", "arc_length": ALONG, "y": y, "z": 0.0 * ALONG}}
    )
    assert error < 0.3 * TIP_TOLERANCE
    assert coarse < 0.3 * TIP_TOLERANCE or told(scene)


@pytest.mark.slow
@pytest.mark.parametrize("width", [0.04, 0.01, 0.004])
def test_a_neck(compared, width):
    """A neck of 80 % of the radius, 4 to 40 mm long, where the arm bends two and a half times as
    much: six intervals step over it. Expected: the tip within the tolerance; the error on 6
    intervals is noticed."""
    places = [0.0, *(0.15 + width * np.array([-0.75, -0.5, 0.5, 0.75])), 0.3]
    radius = {
        "type": "table",
        "arc_length": places,
        "radius": [0.01, 0.01, 0.008, 0.008, 0.01, 0.01],
    }
    coarse, error, scene = compared({"segments.0.radius": radius})
    assert coarse > error < 0.3 * TIP_TOLERANCE
    assert told(scene)


@pytest.mark.parametrize("curvature", [20.0, 60.0])
def test_a_hook_that_hangs(compared, curvature):
    """An arm that is bent without load, by 6 rad, or coiled three times around, and hangs under its
    weight. Expected: the tip within the tolerance; the error on 6 intervals is noticed."""
    gravity = {"effects.gravity.acceleration": [0.0, 0.0, -9.81]}
    coarse, error, scene = compared({"segments.0.curvature": [0.0, curvature, 0.0], **gravity})
    assert error < 0.3 * TIP_TOLERANCE
    assert coarse < 0.3 * TIP_TOLERANCE or told(scene)


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["statics_based", "explicit"])
def test_fields_of_order_twelve(measured, tip_distance, kind):
    """Strain fields of order 12 with helical tendons: the twelve points of 6 intervals cannot tell
    thirteen polynomials apart. Expected: intervals for all of them, and the tip within the
    tolerance; 6 given are told to be too few, or refused."""
    modes = [{"strains": ANGULAR, "order": 12, "span": "rod"}]
    strain = {"type": kind, **({"modes": modes} if kind == "explicit" else {"passive": modes})}
    changes = {"strain": strain, **helices(2)}
    scene = ste.load_scene("three_tendon").replace(changes)
    model = ste.build_model(scene)
    fine = ste.build_model(scene.replace({"quadrature.intervals": 96}))
    exact = ste.static_equilibrium(fine, [5.0, 2.0, 0.0])
    found = ste.static_equilibrium(model, [5.0, 2.0, 0.0], exact.q)
    measured("intervals", model.grid.per_piece)
    measured("tip error [mm]", 1e3 * tip_distance(found.tip_pose, exact.tip_pose))
    assert found.converged
    assert exact.converged
    assert tip_distance(found.tip_pose, exact.tip_pose) < 0.3 * TIP_TOLERANCE
    if kind == "explicit":
        with (
            pytest.raises(
                ste.ConfigurationError, match="alike at the points of 6 quadrature intervals"
            ),
            warnings.catch_warnings(),
        ):
            warnings.simplefilter("ignore")
            ste.build_model(scene.replace({"quadrature.intervals": 6}))
    else:
        assert told(scene)
