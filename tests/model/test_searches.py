"""Searches for tensions: how they leave what has no equilibrium, what counts as a pose, and how
turns and ways are weighed."""

from types import SimpleNamespace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from soft_tendon_env import static_equilibrium, tension_for_tip_pose
from soft_tendon_env.model.inverse_statics import ANGLE_WEIGHT, _TipSearch
from soft_tendon_env.model.model import model_on
from soft_tendon_env.scene.file import load_scene

U = np.array([2.0, 0.5, 1.0])


@pytest.mark.parametrize(
    "limits", [[0.0, 5.0], [0.5, 3.0], [-4.0, -1.0]], ids=["slack", "tight", "pushing"]
)
def test_tensions_without_equilibrium_are_halved_towards_slack(build, monkeypatch, limits):
    """Up to a thousandth of their range from it."""
    model = build("three_tendon", {"tendons.*.tension_limits": limits})
    search = _TipSearch(model, np.eye(4), 0.0)
    tried = []

    def equilibrium(u):
        assert len(tried) < 50
        tried.append(u)
        return SimpleNamespace(converged=False)

    monkeypatch.setattr(search, "equilibrium", equilibrium)
    least, greatest = limits
    slack = np.clip(0.0, least, greatest)
    middle = 0.5 * (least + greatest)
    start = np.array([least, greatest, middle])
    last = search.descend(start, [0.1])
    ways = np.array(tried) - slack
    pulls = np.abs(ways).max(axis=1)
    ratios = pulls[1:] / pulls[:-1]
    np.testing.assert_allclose(ratios, 0.5)
    near = 1e-3 * (greatest - least)
    assert pulls[-1] <= near < pulls[-2]
    np.testing.assert_array_equal(last, tried[-1])


def with_entry(row, column, value):
    pose = np.eye(4)
    pose[row, column] = value
    return pose


@pytest.mark.parametrize(
    "pose",
    [
        with_entry(2, 2, -1.0),
        with_entry(0, 1, 1e-4),
        with_entry(2, 2, 1.0 - 1e-4),
        with_entry(3, 3, 1.0 + 1e-4),
        with_entry(3, 0, -1e-4),
    ],
    ids=["reflection", "shear", "shrunk", "scaled", "projective"],
)
def test_what_is_no_rigid_transform_is_refused(build, pose):
    with pytest.raises(ValueError, match="pose should be a rigid transform"):
        tension_for_tip_pose(build("three_tendon"), pose)


@pytest.mark.parametrize(("turn", "reachable"), [(1.9e-4, True), (2.1e-4, False)])
def test_a_radian_counts_as_half_the_length(build, turn, reachable):
    """Of the 1e-4 of the length by which a tip may be off."""
    model = build("three_tendon")
    pose = static_equilibrium(model, U).tip_pose
    rotation = Rotation.from_rotvec([turn, 0.0, 0.0])
    pose[:3, :3] = pose[:3, :3] @ rotation.as_matrix()
    weight = ANGLE_WEIGHT * model.length
    search = _TipSearch(model, pose, weight)
    solution = search.solution(U)
    assert solution.reachable == reachable
    error = search._error_of(solution)
    half_length = 0.5 * model.length
    assert error == pytest.approx(half_length * turn, rel=1e-6)


def test_the_nearest_pose_is_that_of_the_least_weighted_error(build):
    """Of a place aside from those that three tendons reach with this orientation: no tensions
    nearby have less, a radian half a length."""
    changes = {"tendons.*.tension_limits": [-5.0, 5.0]}
    model = build("three_tendon", changes)
    pose = static_equilibrium(model, U).tip_pose
    pose[:3, 3] += [0.0, 0.02, -0.01]
    found = tension_for_tip_pose(model, pose, start=U)
    assert not found.reachable

    def error(u):
        tip = static_equilibrium(model, u).tip_pose
        relative = np.linalg.inv(tip) @ pose
        rotation = Rotation.from_matrix(relative[:3, :3])
        turn = rotation.magnitude()
        way = np.linalg.norm(relative[:3, 3])
        half_length = 0.5 * model.length
        return np.hypot(way, half_length * turn)

    tension = found.tension
    least = error(tension)
    assert least < 0.9 * error(U)
    assert np.abs(tension).max() < 4.0
    for way in 0.02 * np.eye(3):
        assert error(tension + way) > least
        assert error(tension - way) > least


def test_errors_without_an_equilibrium_are_no_numbers():
    """Of an arm that a push buckles, so that least squares go elsewhere."""
    modes = [{"strains": ["bend_z"], "order": 0, "span": "rod"}]
    strain = {"type": "explicit", "modes": modes}
    changes = {"strain": strain, "effects.tip_load.force": [-1.0, 0.0, 0.0]}
    scene = load_scene("three_tendon").replace(changes)
    model = model_on(scene, 4)
    search = _TipSearch(model, np.eye(4), 0.1)
    slack = np.zeros(3)
    error = search.error(slack)
    assert np.isnan(error).all()
    solution = search.solution(slack)
    assert not solution.reachable
    assert "buckles" in solution.reason
