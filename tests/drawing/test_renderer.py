"""Frames show the arm, its tendons and its target where they are, without a display and without anything that piles up."""

import sys

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.error import DependencyNotInstalled

from soft_tendon_env.drawing.renderer import ArmRenderer, Picture
from soft_tendon_env.drawing.shapes import view_box, viewpoint
from soft_tendon_env.registration import IDS

LOADED = np.array([1.6, 0.0, 0.3])
NO_TRAIL = np.empty((0, 3))


@pytest.fixture
def arm(build):
    """arm("three_tendon", changes): a model, a renderer and what makes pictures of the arm at rest under a tension [N]."""

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
    assert frame.shape == (size[1], size[0], 3) and frame.dtype == np.uint8
    assert frame.max() == 255 and frame.min() < 120, "paper and ink"


def test_flat_sections_and_discs_are_as_wide_as_they_are(arm):
    flat = {"radius": None, "section": {"type": "rectangle", "width": 0.002, "height": 0.04}}
    wide = {"segments.0.discs": {"mass": 1e-3, "radius": 0.05, "places": [0.15], "thickness": 0.004}}
    frames = []
    for changes in ({}, {f"segments.0.{key}": value for key, value in flat.items()}, wide):
        _, renderer, picture = arm("three_tendon", changes)
        frames.append(renderer.frame(picture(0.0 * LOADED)))
    sizes = [np.ptp(changed(frames[0], frame), axis=0) for frame in frames[1:]]
    assert min(map(max, sizes)) > 20, "pixels"


def test_the_tip_is_painted_where_the_model_has_it(arm):
    model, renderer, picture = arm("three_tendon")
    straight, bent = (renderer.frame(picture(tension)) for tension in (0.0 * LOADED, LOADED))
    pixels = changed(straight, bent)
    for tension in (0.0 * LOADED, LOADED):
        tip = pixel(renderer, model.tip_pose(model.rest_coordinates(tension))[:3, 3])
        assert np.linalg.norm(pixels - tip, axis=1).min() < 5.0
    mount = pixel(renderer, np.array([-0.06 * model.length, 0.0, 0.0]))
    assert np.linalg.norm(pixels - mount, axis=1).min() > 5.0, "the mount stays"


@pytest.mark.parametrize("acceleration", [*np.vstack([9.81 * np.eye(3), -9.81 * np.eye(3)]).tolist()], ids=str)
def test_gravity_points_down_in_the_picture(arm, acceleration):
    model, renderer, picture = arm("three_tendon", {"effects.gravity": {"acceleration": acceleration}})
    assert renderer.frame(picture(np.zeros(3))).min() < 120
    down = pixel(renderer, np.array(acceleration)) - pixel(renderer, np.zeros(3))
    assert down[0] > 0.0 and abs(down[1]) < 1e-6 * down[0]
    right, up, viewer = renderer.turn
    assert np.allclose(np.cross(right, up), viewer), "no mirror image"
    assert np.allclose(renderer.turn @ renderer.turn.T, np.eye(3)), "equal scales"
    *_, vertical, upright = view_box(model.scene)
    np.testing.assert_allclose(viewpoint(vertical, upright), renderer.turn, atol=1e-12)  # from where recordings are seen
    for point in (np.zeros(3), [model.length, 0.0, 0.0]):
        assert (pixel(renderer, np.array(point)) > 40).all() and (pixel(renderer, np.array(point)) < [440, 560]).all()


def test_rows_of_an_environment_have_the_frames_of_single_ones():
    options = {"scene": "three_tendon", "fidelity": "fast", "render_mode": "rgb_array"}
    env, rows = gym.make(IDS["Shape"], **options), gym.make_vec(IDS["Shape"], num_envs=2, **options)
    rows.reset(seed=0)
    env.reset(seed=1)
    np.testing.assert_array_equal(rows.render()[1], env.render())
    assert env.metadata["render_fps"] == 50, "of its videos"


def test_without_matplotlib_the_error_says_what_to_install(build, monkeypatch):
    for name in ("matplotlib", "matplotlib.backends.backend_agg"):
        monkeypatch.setitem(sys.modules, name, None)
    with pytest.raises(DependencyNotInstalled, match=r'pip install "soft_tendon_env\[pictures\]"'):
        ArmRenderer(build("three_tendon"))
