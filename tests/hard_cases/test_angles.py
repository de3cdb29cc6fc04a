"""Rotation at and across every switch.

The coefficients of exp and of its tangent come from a series below theta^2 = 1 and from closed
forms above, and closed forms lose their digits or divide by zero in unlucky places: near 0, at pi,
at 2 pi. A Magnus interval reaches such angles when the rod is curved by nature or curls by several
turns; half of them agree with twice as many intervals only if both sides of every switch are right.
"""

import numpy as np
import pytest

import soft_tendon_env as ste
from soft_tendon_env.model.statics import static_equilibrium

AXES = {"bend": (0, 0, 1), "twist": (1, 0, 0), "helix": (0.6, 0, 0.8)}
SWITCHES = {"1 rad": 1.0, "pi": np.pi, "2 pi": 2 * np.pi}
INTERVALS = 6


@pytest.mark.slow
@pytest.mark.filterwarnings(
    "ignore:.*coordinates are too many"
)  # at 2 pi every interval closes a circle: its end does not move
@pytest.mark.parametrize("axis", AXES)
@pytest.mark.parametrize("angle", SWITCHES)
def test_interval_that_turns_by_an_angle_of_a_switch(one_segment, measured, axis, angle):
    """An interval of a pre-curved rod turns by just less than, exactly and just more than 1 rad
    (where the series ends), pi and 2 pi. Expected: pose and mass matrix are continuous across the
    angle, and the pose is that of a rod with twice the intervals."""

    def model(relative, intervals):
        angle_per_interval = SWITCHES[angle] * (1 + relative)
        curvature = angle_per_interval * INTERVALS * np.array(AXES[axis])
        return one_segment(curvature=curvature, changes={"quadrature.intervals": intervals})

    rest = np.zeros(3)
    at = model(0, INTERVALS)
    finer = model(0, 2 * INTERVALS)
    difference = at.tip_pose(rest) - finer.tip_pose(rest)
    misfit = np.abs(difference).max()
    measured("against twice the intervals", misfit)
    assert misfit < 1e-13
    q = [1.0, 0.5, -0.2]
    q_dot = [1.0, -2.0, 3.0]
    here = at.terms(q, q_dot)
    for relative in (-1e-6, -1e-9, 1e-9, 1e-6):
        near = model(relative, INTERVALS).terms(q, q_dot)
        for name in ("mass", "bias", "tip_pose", "tip_jacobian", "tip_bias"):
            here_value = getattr(here, name)
            near_value = getattr(near, name)
            change = np.abs(here_value - near_value)
            size = np.abs(here_value).max()
            jump = change.max() / size
            bound = 1e3 * abs(relative) + 1e-11
            assert jump < bound, (name, relative, jump)


@pytest.mark.parametrize("turns", [1.3, 5.3, 20.3, 100.3])
def test_rod_of_many_turns(one_segment, measured, turns):
    """A stress-free rod wound up into many turns, so that every interval turns by up to 17 times 2
    pi. Expected: the tip is where the circle says, and the rod swings and settles when it is
    pulled."""
    k = 2 * np.pi * turns
    model = one_segment(curvature=(0, 0, k))
    misfit = np.abs(
        model.tip_pose(np.zeros(3))[:3, 3] - [np.sin(k) / k, (1 - np.cos(k)) / k, 0]
    ).max()
    measured("tip error [m]", misfit)
    assert misfit < 1e-12
    tension = [1.0, 0.5, 0.0]
    motion = ste.simulate(model, tension, 30.0, 0.01)
    rest = static_equilibrium(model, tension)
    assert rest.converged
    assert np.isfinite(motion.q).all()
    assert np.abs(motion.q).max() < 2.0
    difference = motion.q[-1] - rest.q
    assert np.abs(difference).max() < 0.01


@pytest.mark.parametrize("tension", [10.0, 20.0, 40.0])
def test_arm_that_curls_by_more_than_a_turn(build, measured, one_pulled, tension):
    """The soft three-tendon arm is pulled by up to eight times its limit, until it lies in several
    turns. Expected: statics converge, the motion ends there, and the tip is where a rod with four
    times the intervals has it."""
    model = build("three_tendon")
    finer = build("three_tendon", {"quadrature.intervals": 24})
    u = one_pulled(model, 0, tension)
    rest = static_equilibrium(model, u)
    arc_length, xi = model.strain(rest.q)
    mean_curvature = xi[:, 2].mean()
    turned = np.rad2deg(mean_curvature * model.length)
    measured("turned [deg]", turned)
    assert rest.converged
    assert turned > 32 * tension
    motion = ste.simulate(model, u, 10.0, 0.01)
    difference = motion.tip_pose[-1] - rest.tip_pose
    assert np.abs(difference).max() < 1e-9
    difference_of_finer = finer.tip_pose(rest.q) - rest.tip_pose
    assert np.abs(difference_of_finer).max() < 1e-9


def test_straight_rod_at_rest(measured):
    """Zero over zero: no curvature, no motion, no tension, where angles, chords' slopes and
    velocities vanish. Expected: every term is finite, the mass matrix is positive definite, and
    nothing moves, not by one bit."""
    for name in ste.scene_names():
        scene = ste.load_scene(name)
        if (
            any(any(segment.curvature) for segment in scene.segments)
            or scene.effects.model_fields_set
        ):
            continue
        model = ste.build_model(scene)
        rest = np.zeros(model.coordinate_count)
        terms = model.terms(rest, rest)
        are_finite = (np.isfinite(term).all() for term in terms)
        assert all(are_finite), name
        assert np.linalg.eigvalsh(terms.mass)[0] > 0, name
        motion = ste.simulate(model, np.zeros(model.tendon_count), 0.2, 0.02)
        assert not motion.q.any(), name
        assert not motion.q_dot.any(), name
        across = motion.tip_pose[-1, 1:3, 3]
        measured("tip off the axis [m]", np.abs(across).max())
        position = motion.tip_pose[-1, :3, 3]
        difference = position - [model.length, 0, 0]
        assert np.abs(difference).max() < 1e-15, name
