"""Tensions for a tip pose: the paper's circle, round trips, least effort, limits, targets out of
reach."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from soft_tendon_env import (
    load_scene,
    static_equilibrium,
    tension_for_tip_pose,
    tension_for_tip_position,
)
from soft_tendon_env.model.build import build_model
from soft_tendon_env.model.inverse_statics import ANGLE_WEIGHT, _TipSearch

TILT = np.radians(37.8)


@pytest.fixture(scope="module")
def paper():
    scene = load_scene("paper")
    return build_model(scene)


def circle(angle):
    """The paper's circle: radius 0.25 m about the x axis, the tip's axis tilted outwards."""
    cosine = np.cos(angle)
    sine = np.sin(angle)
    outwards = np.array([0.0, cosine, sine])
    pose = np.eye(4)
    rotation_vector = TILT * np.cross([1.0, 0.0, 0.0], outwards)
    pose[:3, :3] = Rotation.from_rotvec(rotation_vector).as_matrix()
    aside = 0.25 * outwards[1:]
    pose[:3, 3] = [0.95, *aside]
    return pose


@pytest.mark.parametrize("angle", [0.0, 2.0])
def test_the_circle_needs_pushes(paper, angle):
    pose = circle(angle)
    changes = {"tendons.*.tension_limits": [-20.0, 20.0]}
    pushing = paper.scene.replace(changes)
    either = tension_for_tip_pose(paper.with_scene(pushing), pose)
    assert either.reachable
    assert either.reason == ""
    assert either.position_error < 1e-8
    assert either.angle_error < 1e-8
    assert np.abs(either.tension).max() < 6.0
    assert either.tension.min() < -1.0
    pulls = tension_for_tip_pose(paper, pose)
    assert not pulls.reachable
    assert 3e-3 < pulls.position_error < 8e-3
    assert pulls.tension.min() >= 0.0


@pytest.mark.parametrize("name", ["paper_16dof", "four_tendon", "helical", "catheter"])
def test_round_trip(name):
    scene = load_scene(name)
    model = build_model(scene)
    tension_limits = [tendon.tension_limits for tendon in model.scene.tendons]
    least, greatest = np.array(tension_limits).T
    for u in np.random.default_rng(5).uniform(
        least, least + 0.3 * (greatest - least), (2, least.size)
    ):
        wanted = static_equilibrium(model, u)
        found = tension_for_tip_pose(model, wanted.tip_pose)
        assert found.reachable
        np.testing.assert_allclose(found.tip_pose, wanted.tip_pose, atol=1e-6)
        least_needed = np.linalg.norm(u)
        assert np.linalg.norm(found.tension) <= least_needed + 1e-6
        assert (found.tension >= least).all()
        assert (found.tension <= greatest).all()
        equilibrium = static_equilibrium(model, found.tension)
        np.testing.assert_array_equal(found.q, equilibrium.q)


def test_limits_that_are_not_zero_are_kept_where_they_bind(build):
    """Three tendons have one set of tensions for a position; both bounds are met there."""
    limits = [0.5, 3.0]
    model = build("three_tendon", {"tendons.*.tension_limits": limits})
    u = np.array([0.5, 3.0, 1.5])
    wanted = static_equilibrium(model, u)
    found = tension_for_tip_position(model, wanted.tip_pose[:3, 3])
    assert found.reachable
    np.testing.assert_allclose(found.tension, u, rtol=1e-3)
    assert found.tension.min() >= 0.5
    assert found.tension.max() <= 3.0


def test_what_is_out_of_reach_is_approached():
    model = build_model(
        load_scene("three_tendon").replace({"tendons.*.tension_limits": [0.0, 2.0]})
    )
    for target in ([0.6, 0.0, 0.0], [0.0, 0.5, 0.2]):
        found = tension_for_tip_position(model, target)
        assert not found.reachable
        assert "m and" in found.reason
        assert (found.tension >= 0.0).all()
        assert (found.tension <= 2.0).all()
        axes = [np.linspace(0.0, 2.0, 7)] * 3
        grid = np.stack(np.meshgrid(*axes), axis=-1)
        positions = []
        for u in grid.reshape(-1, 3):
            rest = static_equilibrium(model, u)
            positions.append(rest.tip_pose[:3, 3])
        tips = np.array(positions)
        nearest = np.linalg.norm(tips - target, axis=1).min()
        assert found.position_error <= nearest + 1e-5


@pytest.mark.slow
def test_a_start_next_to_the_strain_limit_is_answered():
    """The equilibrium exists, and its derivative grows without bound."""
    model = build_model(
        load_scene("three_tendon").replace({"tendons.*.tension_limits": [0.0, 90.0]})
    )
    below = 44.0
    above = 45.0
    while below < (middle := 0.5 * (below + above)) < above:
        rest = static_equilibrium(model, [middle, 0.0, 0.0])
        if rest.converged:
            below = middle
        else:
            above = middle
    for start in (below, below - 1e-7):
        found = tension_for_tip_position(model, [0.2, 0.1, 0.0], start=[start, 0.0, 0.0])
        assert not found.reachable
        assert "the nearest tip found is" in found.reason
        np.testing.assert_allclose(found.tension, [start, 0.0, 0.0], atol=1e-8)


@pytest.mark.parametrize(
    ("pose", "options", "message"),
    [
        (np.diag([1.0, 1.0, 1.1, 1.0]), {}, "pose should be a rigid transform"),
        (np.eye(4), {"start": np.zeros(9)}, r"start should have shape \(10,\)"),
    ],
)
def test_bad_input_is_refused(paper, pose, options, message):
    with pytest.raises(ValueError, match=message):
        tension_for_tip_pose(paper, pose, **options)


@pytest.mark.parametrize("angle_weight", [0.0, 0.4])
@pytest.mark.parametrize("changes", [{}, {"effects.gravity.acceleration": [0.0, 0.0, -9.81]}])
def test_derivatives_of_the_error_are_differences(angle_weight, changes):
    """Of the weighted rotation vector and displacement from the tip to the desired pose."""
    scene = load_scene("three_tendon").replace(changes)
    model = build_model(scene)
    search = _TipSearch(model, circle(0.7), angle_weight)
    u = np.array([2.0, 0.5, 1.0])
    h = 1e-5
    slopes = []
    for way in h * np.eye(3):
        ahead = search.error(u + way)
        behind = search.error(u - way)
        change = ahead - behind
        slopes.append(change / (2 * h))
    atol = 1e-6 * np.abs(slopes).max()
    expected = np.transpose(slopes)
    np.testing.assert_allclose(search.derivative(u), expected, atol=atol)
    tip = static_equilibrium(model, u).tip_pose
    goal = search.pose
    error = search.error(u)
    way = goal[:3, 3] - tip[:3, 3]
    np.testing.assert_allclose(error[3:], way, atol=1e-14)
    tip_rotation = tip[:3, :3]
    goal_rotation = goal[:3, :3]
    relative = tip_rotation.T @ goal_rotation
    turn = Rotation.from_matrix(relative).as_rotvec()
    np.testing.assert_allclose(error[:3], angle_weight * turn, atol=1e-12)


def test_a_solution_says_how_far_its_tip_is_off():
    """A place 1e-4 of the length away counts as reached, and a radian as half a length."""
    scene = load_scene("three_tendon")
    model = build_model(scene)
    u = np.array([2.0, 0.5, 1.0])
    tip = static_equilibrium(model, u).tip_pose
    for off, turn, reachable in ((0.9e-4, 0.0, True), (1.1e-4, 0.0, False), (0.0, 3e-4, False)):
        pose = tip.copy()
        pose[2, 3] += off * model.length
        rotation = Rotation.from_rotvec([0.0, turn, 0.0]).as_matrix()
        pose[:3, :3] = tip[:3, :3] @ rotation
        inverse = _TipSearch(model, pose, ANGLE_WEIGHT * model.length)
        solution = inverse.solution(u)
        assert solution.reachable == reachable
        distance = off * model.length
        assert solution.position_error == pytest.approx(distance, abs=1e-12)
        assert solution.angle_error == pytest.approx(turn, abs=1e-12)
        assert (solution.reason == "") == reachable
    position = _TipSearch(model, pose, 0.0).solution(u)
    assert position.reachable
    assert position.angle_error == 0.0


def test_errors_and_efforts_are_least_within_the_limits():
    """|e / L|^2 + mu^2 |u / unit|^2 has no slope along tensions between their limits, and falls
    beyond those at one."""
    scene = load_scene("three_tendon")
    model = build_model(scene)
    pose = static_equilibrium(model, [2.0, 0.5, 1.0]).tip_pose
    search = _TipSearch(model, pose, 0.0)
    mu = 0.1
    unit = 2.0
    u = search._least_squares(np.array([1.0, 0.8, 1.2]), mu, unit)
    error = search.error(u) / model.length
    slopes = search.derivative(u) * unit / model.length
    effort = mu**2 * u / unit
    slope = slopes.T @ error + effort
    size = np.abs(effort).max()
    is_slack = u < 1e-6
    assert not is_slack.all()
    np.testing.assert_allclose(slope[~is_slack], 0.0, atol=1e-3 * size)
    assert (slope[is_slack] > -1e-3 * size).all()
    # less of the effort leaves less of the error
    looser = search._least_squares(u, 0.1 * mu, unit)
    looser_error = np.linalg.norm(search.error(looser))
    assert looser_error < 0.5 * np.linalg.norm(search.error(u))
