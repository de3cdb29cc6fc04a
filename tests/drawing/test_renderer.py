"""Pictures show the arm, its tendons and its target where they are; curves, surfaces of solids and
styles of policies."""

import sys

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.error import DependencyNotInstalled

from soft_tendon_env.drawing.palette import style, styles
from soft_tendon_env.drawing.renderer import ArmRenderer, Picture
from soft_tendon_env.drawing.shapes import (
    backbones,
    base_poses,
    surface,
    tendon_curves,
    view_box,
    viewpoint,
)
from soft_tendon_env.effects.contact import Contact
from soft_tendon_env.model.simulation import Simulation
from soft_tendon_env.registration import IDS

LOADED = np.array([1.6, 0.0, 0.3])
NO_TRAIL = np.empty((0, 3))
BOX = np.array([-0.5, -0.5, -0.5]), np.array([0.5, 0.5, 0.5])
VOLUMES = [
    ({"type": "sphere", "radius": 0.1}, 4.0 / 3.0 * np.pi * 1e-3),
    (
        {"type": "capsule", "radius": 0.1, "length": 0.3, "axis": [1.0, 2.0, 0.0]},
        4.0 / 3.0 * np.pi * 1e-3 + 0.3 * np.pi * 1e-2,
    ),
    (
        {"type": "cylinder", "radius": 0.1, "length": 0.3, "axis": [1.0, 2.0, 0.0]},
        0.3 * np.pi * 1e-2,
    ),
    ({"type": "box", "size": [0.1, 0.2, 0.3], "rotation": [10.0, 20.0, 30.0]}, 0.006),
]


@pytest.fixture
def arm(build):
    """arm("three_tendon", changes): a model, a renderer and what makes pictures of the arm at rest
    under a tension [N]."""

    def made(name, changes=None, **size):
        model = build(name, changes)

        def picture(tension, **shown):
            nothing = {"trail": NO_TRAIL, "target_pose": None, "target_backbone": None, "title": ""}
            strain = model.strain(model.rest_coordinates(tension))[1]
            return Picture(strain, tension, **{**nothing, **shown})

        return model, ArmRenderer(model, **size), picture

    return made


def changed(frame, other):
    """Rows and columns (n, 2) of the pixels that differ clearly."""
    return np.argwhere(np.abs(frame.astype(int) - other).max(axis=2) > 40)


def pixel(renderer, point):
    """Row and column at which a point (3,) [m] is seen."""
    (artist, *_) = renderer.artists
    x, y = artist.get_transform().transform(renderer.turn[:2] @ point)
    return np.array([artist.get_figure().bbox.height - y, x])


@pytest.mark.parametrize("size", [(640, 480), (321, 517)])
def test_a_frame_has_the_size_asked_for(arm, size):
    _, renderer, picture = arm("three_tendon", width=size[0], height=size[1])
    frame = renderer.frame(picture(LOADED))
    assert frame.shape == (size[1], size[0], 3)
    assert frame.dtype == np.uint8
    assert frame.max() == 255, "paper and ink"
    assert frame.min() < 120, "paper and ink"


def test_flat_sections_and_discs_are_as_wide_as_they_are(arm):
    flat = {"radius": None, "section": {"type": "rectangle", "width": 0.002, "height": 0.04}}
    wide = {
        "segments.0.discs": {"mass": 1e-3, "radius": 0.05, "places": [0.15], "thickness": 0.004}
    }
    frames = []
    for changes in ({}, {f"segments.0.{key}": value for key, value in flat.items()}, wide):
        _, renderer, picture = arm("three_tendon", changes)
        frames.append(renderer.frame(picture(0.0 * LOADED)))
    sizes = [np.ptp(changed(frames[0], frame), axis=0) for frame in frames[1:]]
    assert min(map(max, sizes)) > 20, "pixels"


def test_the_tip_is_painted_where_the_model_has_it(arm):
    model, renderer, picture = arm("three_tendon")
    slack = 0.0 * LOADED
    straight = renderer.frame(picture(slack))
    bent = renderer.frame(picture(LOADED))
    pixels = changed(straight, bent)
    for tension in (slack, LOADED):
        q = model.rest_coordinates(tension)
        tip = pixel(renderer, model.tip_pose(q)[:3, 3])
        assert np.linalg.norm(pixels - tip, axis=1).min() < 5.0
    behind_base = np.array([-0.06 * model.length, 0.0, 0.0])
    mount = pixel(renderer, behind_base)
    assert np.linalg.norm(pixels - mount, axis=1).min() > 5.0, "the mount stays"


@pytest.mark.parametrize(
    "acceleration", [*np.vstack([9.81 * np.eye(3), -9.81 * np.eye(3)]).tolist()], ids=str
)
def test_gravity_points_down_in_the_picture(arm, acceleration):
    model, renderer, picture = arm(
        "three_tendon", {"effects.gravity": {"acceleration": acceleration}}
    )
    assert renderer.frame(picture(np.zeros(3))).min() < 120
    down = pixel(renderer, np.array(acceleration)) - pixel(renderer, np.zeros(3))
    assert down[0] > 0.0
    assert abs(down[1]) < 1e-6 * down[0]
    right, up, viewer = renderer.turn
    assert np.allclose(np.cross(right, up), viewer), "no mirror image"
    assert np.allclose(renderer.turn @ renderer.turn.T, np.eye(3)), "equal scales"
    *_, vertical, upright = view_box(model.scene)
    np.testing.assert_allclose(
        viewpoint(vertical, upright), renderer.turn, atol=1e-12
    )  # from where recordings are seen
    for point in (np.zeros(3), [model.length, 0.0, 0.0]):
        assert (pixel(renderer, np.array(point)) > 40).all()
        assert (pixel(renderer, np.array(point)) < [440, 560]).all()


def test_rows_of_an_environment_have_the_frames_of_single_ones():
    options = {"scene": "three_tendon", "fidelity": "fast", "render_mode": "rgb_array"}
    env = gym.make(IDS["Shape"], **options)
    rows = gym.make_vec(IDS["Shape"], num_envs=2, **options)
    rows.reset(seed=0)
    env.reset(seed=1)
    np.testing.assert_array_equal(rows.render()[1], env.render())
    assert env.metadata["render_fps"] == 50, "of its videos"


def test_without_matplotlib_the_error_says_what_to_install(build, monkeypatch):
    for name in ("matplotlib", "matplotlib.backends.backend_agg"):
        monkeypatch.setitem(sys.modules, name, None)
    with pytest.raises(DependencyNotInstalled, match=r'pip install "soft_tendon_env\[pictures\]"'):
        ArmRenderer(build("three_tendon"))


@pytest.fixture(params=["three_tendon", "paper", "helical"])
def model(request, build):
    return build(request.param, {"quadrature.intervals": 4})


def test_tendons_run_where_the_routing_says(model, random_state):
    """As long as the model says where there are points enough, and at their offset from the
    backbone."""
    q, _ = random_state(model, 1)
    arc_length = np.linspace(0.0, model.length, 4001)
    backbone = backbones(model, model.strain(q)[1][None], arc_length)
    curves = tendon_curves(model, backbone, arc_length)
    assert len(curves) == model.tendon_count
    for tendon, curve, length in zip(
        model.scene.tendons, curves, model.tendon_lengths(q), strict=True
    ):
        assert curve.shape[0] == 1
        assert curve.shape[2] == 3
        assert np.linalg.norm(np.diff(curve[0], axis=0), axis=1).sum() == pytest.approx(
            length, rel=2e-3
        )
        inside = (arc_length >= tendon.start) & (arc_length <= (tendon.end or model.length))
        local = np.einsum(
            "mji,mj->mi", backbone[0, inside, :3, :3], curve[0] - backbone[0, inside, :3, 3]
        )
        np.testing.assert_allclose(local[:, 0], 0.0, atol=1e-12)


def test_a_base_that_moves_takes_the_arm_along(build):
    """From where it is in the world; and one that was drawn for an episode takes it elsewhere."""
    motion = {"velocity": [0.1, 0.2, 0.3], "angular_velocity": 2.0, "axis": [1.0, 1.0, 0.0]}
    model = build(
        "three_tendon",
        {
            "quadrature.intervals": 4,
            "effects.moving_base": motion,
            "base.position": [0.0, 0.0, 0.4],
        },
    )
    simulation = Simulation(model)
    simulation.step([2.0, 0.0, 1.0], 0.3)
    base = base_poses(model, np.array([0.3]))
    (tip,) = backbones(model, simulation.state.strain[None], np.array([model.length]), base)[0]
    np.testing.assert_allclose(tip, simulation.tip_pose, atol=1e-9)
    resting = model.scene.replace(
        {"effects.moving_base.velocity": [0.0, 0.0, 0.0], "base.position": [1.0, 2.0, 3.0]}
    )
    np.testing.assert_allclose(
        base_poses(model, np.array([0.3]), resting)[0, :3, 3], [1.0, 2.0, 3.0], atol=1e-15
    )
    np.testing.assert_allclose(base[0, :3, 3], [0.03, 0.06, 0.49], atol=1e-15)
    lower, upper, *_ = view_box(resting)
    assert ((lower < [1.0, 2.0, 3.0]) & (upper > [1.0 + model.length, 2.0, 3.0])).all()


@pytest.mark.parametrize(
    ("obstacle", "volume"),
    VOLUMES,
    ids=lambda value: value["type"] if isinstance(value, dict) else "",
)
def test_surfaces_hold_the_volume_and_lie_on_the_obstacle(obstacle, volume):
    contact = Contact(obstacles=[{**obstacle, "position": [0.1, 0.2, 0.3]}])
    corners = surface(contact.obstacles[0], 0.0, BOX)
    # the divergence theorem: a third of the flux of the position through the quadrangles
    first_diagonal = corners[:, 2] - corners[:, 0]
    second_diagonal = corners[:, 3] - corners[:, 1]
    area = 0.5 * np.cross(first_diagonal, second_diagonal)
    position = corners.mean(axis=1) - [0.1, 0.2, 0.3]
    flux = np.sum(area * position)
    assert flux / 3.0 == pytest.approx(volume, rel=0.05)
    distances = contact.distances(corners.reshape(-1, 3))
    assert np.abs(distances).max() < 1e-12


def test_policies_that_are_drawn_together_differ():
    variants = ("filtered:predictive", "robust_predictive", "long_horizon_predictive")
    names = ["predictive", *variants, "ppo", "ppo_long", "arm", "own"]
    found = styles(names)
    assert len({look.colour for look in found.values()}) == len(names)
    assert found["ppo"].marker == found["ppo_long"].marker == "o"
    assert found["predictive"].marker == "s"
    trainings = styles(
        ["DAgger", "DAgger, loads", "DAgger, water", *(f"ppo_{number}" for number in range(9))]
    )
    assert len({look.colour for look in trainings.values()}) == len(trainings)
    assert {look.marker for look in trainings.values()} == {"o"}
    assert found["predictive"] == style("predictive")
    assert found["ppo"] == style("ppo")
