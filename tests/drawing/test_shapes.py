"""The arm as curves in space, surfaces of solids, and the styles of policies."""

import numpy as np
import pytest

from soft_tendon_env.drawing.palette import style, styles
from soft_tendon_env.drawing.shapes import (
    backbones,
    base_poses,
    surface,
    tendon_curves,
)
from soft_tendon_env.effects.contact import Contact
from soft_tendon_env.model.simulation import Simulation

BOX = np.array([-0.5, -0.5, -0.5]), np.array([0.5, 0.5, 0.5])
VOLUMES = [
    ({"type": "sphere", "radius": 0.1}, 4.0 / 3.0 * np.pi * 1e-3),
    ({"type": "capsule", "radius": 0.1, "length": 0.3, "axis": [1.0, 2.0, 0.0]}, 4.0 / 3.0 * np.pi * 1e-3 + 0.3 * np.pi * 1e-2),
    ({"type": "cylinder", "radius": 0.1, "length": 0.3, "axis": [1.0, 2.0, 0.0]}, 0.3 * np.pi * 1e-2),
    ({"type": "box", "size": [0.1, 0.2, 0.3], "rotation": [10.0, 20.0, 30.0]}, 0.006),
]


@pytest.fixture(params=["three_tendon", "paper", "helical"])
def model(request, build):
    return build(request.param, {"quadrature.intervals": 4})


def test_tendons_run_where_the_routing_says(model, random_state):
    """As long as the model says where there are points enough, and at their offset from the backbone."""
    q, _ = random_state(model, 1)
    arc_length = np.linspace(0.0, model.length, 4001)
    backbone = backbones(model, model.strain(q)[1][None], arc_length)
    curves = tendon_curves(model, backbone, arc_length)
    assert len(curves) == model.tendon_count
    for tendon, curve, length in zip(model.scene.tendons, curves, model.tendon_lengths(q), strict=True):
        assert curve.shape[0] == 1 and curve.shape[2] == 3
        assert np.linalg.norm(np.diff(curve[0], axis=0), axis=1).sum() == pytest.approx(length, rel=2e-3)
        inside = (arc_length >= tendon.start) & (arc_length <= (tendon.end or model.length))
        local = np.einsum("mji,mj->mi", backbone[0, inside, :3, :3], curve[0] - backbone[0, inside, :3, 3])
        np.testing.assert_allclose(local[:, 0], 0.0, atol=1e-12)


def test_a_base_that_moves_takes_the_arm_along(build):
    """From where it is in the world; and one that was drawn for an episode takes it elsewhere."""
    motion = {"velocity": [0.1, 0.2, 0.3], "angular_velocity": 2.0, "axis": [1.0, 1.0, 0.0]}
    model = build("three_tendon", {"quadrature.intervals": 4, "effects.moving_base": motion, "base.position": [0.0, 0.0, 0.4]})
    simulation = Simulation(model)
    simulation.step([2.0, 0.0, 1.0], 0.3)
    base = base_poses(model, np.array([0.3]))
    (tip,) = backbones(model, simulation.state.strain[None], np.array([model.length]), base)[0]
    np.testing.assert_allclose(tip, simulation.tip_pose, atol=1e-9)
    resting = model.scene.replace({"effects.moving_base.velocity": [0.0, 0.0, 0.0], "base.position": [1.0, 2.0, 3.0]})
    np.testing.assert_allclose(base_poses(model, np.array([0.3]), resting)[0, :3, 3], [1.0, 2.0, 3.0], atol=1e-15)
    np.testing.assert_allclose(base[0, :3, 3], [0.03, 0.06, 0.49], atol=1e-15)


@pytest.mark.parametrize(("obstacle", "volume"), VOLUMES, ids=lambda value: value["type"] if isinstance(value, dict) else "")
def test_surfaces_hold_the_volume_and_lie_on_the_obstacle(obstacle, volume):
    contact = Contact(obstacles=[{**obstacle, "position": [0.1, 0.2, 0.3]}])
    corners = surface(contact.obstacles[0], 0.0, BOX)
    area = 0.5 * np.cross(corners[:, 2] - corners[:, 0], corners[:, 3] - corners[:, 1])
    assert np.sum(area * (corners.mean(axis=1) - [0.1, 0.2, 0.3])) / 3.0 == pytest.approx(volume, rel=0.05)
    assert np.abs(contact.distances(corners.reshape(-1, 3))).max() < 1e-12


def test_policies_that_are_drawn_together_differ():
    variants = ("filtered:predictive", "adaptive:predictive", "robust_predictive", "long_horizon_predictive")
    names = ["predictive", *variants, "ppo", "ppo_long", "arm", "own"]
    found = styles(names)
    assert len({look.colour for look in found.values()}) == len(names)
    assert found["ppo"].marker == found["ppo_long"].marker == "o" and found["predictive"].marker == "s"
    trainings = styles(["DAgger", "DAgger, loads", "DAgger, water", *(f"ppo_{number}" for number in range(9))])
    assert len({look.colour for look in trainings.values()}) == len(trainings) and {look.marker for look in trainings.values()} == {"o"}
    assert found["predictive"] == style("predictive") and found["ppo"] == style("ppo")
