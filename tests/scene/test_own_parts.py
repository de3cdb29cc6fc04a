"""Sections, routings and strains from outside of the package, those of the examples: their
definitions, tables of scenes with them, and what is refused."""

import runpy
from pathlib import Path

import numpy as np
import pytest

from soft_tendon_env import ConfigurationError, load_scene
from soft_tendon_env.model.build import build_model
from soft_tendon_env.model.reference_model import part_borders
from soft_tendon_env.scene.scene import Scene, scene_to_dict
from soft_tendon_env.scene.sections import Rectangle

EXAMPLES = Path(__file__).parents[2] / "examples"


@pytest.fixture
def example(forgotten):
    """example("own_section"): the names of an example, which registers what it has."""
    return lambda name: runpy.run_path(str(EXAMPLES / f"{name}.py"), run_name=name)


def test_a_hollow_rectangle_is_its_outline_less_its_hole(example):
    hollow = example("own_section")["HollowRectangle"](width=0.02, height=0.012, wall=0.002)
    sizes = np.array([[0.02], [0.012], [0.002]])
    outline, hole = (
        Rectangle(width=width, height=height).integrals(np.array([[width], [height]]))
        for width, height in ((0.02, 0.012), (0.016, 0.008))
    )
    for i in range(3):  # area and second moments, which add up
        np.testing.assert_allclose(hollow.integrals(sizes)[i], outline[i] - hole[i], rtol=1e-12)
    np.testing.assert_allclose(hollow.outer_radius(np.zeros(1), 0.1)[0], np.hypot(0.01, 0.006))


def test_torsion_of_a_thin_square_wall_is_that_of_bredt(example):
    """J = a^3 t of a square of side a between the middles of its walls t."""
    hollow = example("own_section")["HollowRectangle"]
    a = 0.02
    wall = 1e-5
    sizes = np.array([[a + wall], [a + wall], [wall]])
    section = hollow(width=a + wall, height=a + wall, wall=wall)
    np.testing.assert_allclose(section.integrals(sizes)[3], a**3 * wall, rtol=1e-9)


def test_a_scene_with_a_section_of_ones_own_is_saved_and_checked(example):
    scene = example("own_section")["SCENE"]
    assert Scene(**scene_to_dict(scene)) == scene
    assert scene_to_dict(scene)["segments"][0]["section"]["type"] == "hollow_rectangle"
    with pytest.raises(ConfigurationError, match=r"segments\[0\].section.wall is too thick"):
        scene.replace({"segments.0.section.wall": 0.006})
    with pytest.raises(
        ConfigurationError, match="type is 'hollow_rect': did you mean 'hollow_rectangle"
    ):
        scene.replace({"segments.0.section.type": "hollow_rect"})


def test_the_slope_of_a_routing_of_ones_own_is_the_derivative_of_its_offset(example):
    scene = example("own_routing")["SCENE"]
    routing = scene.tendons[0].routing
    places = np.linspace(0.01, 0.29, 41)
    h = 1e-6
    ends = (0.0, 0.3)

    def at(arc_length):
        return routing.offset_and_slope(arc_length, None, None, ends)

    differences = (at(places + h)[0] - at(places - h)[0]) / (2 * h)
    np.testing.assert_allclose(at(places)[1], differences, atol=1e-8)
    radii = np.linalg.norm(at(np.array(ends))[0], axis=1)
    np.testing.assert_allclose(radii, [0.009, 0.005], rtol=1e-12)
    assert Scene(**scene_to_dict(scene)) == scene
    # 20 rad/m over 0.3 m turn by 0.95 of a turn: twice as fast makes two parts
    assert part_borders(scene) == []
    faster = scene.replace({"tendons.0.routing.angular_rate": 40.0})
    np.testing.assert_allclose(part_borders(faster), [0.15])


def test_stiffness_of_a_strain_of_ones_own_is_the_energy_of_its_fields(example):
    """Cosines are orthogonal over the rod: E I L of the constant, half as much of the others."""
    example("own_strain")
    strain = {"type": "cosines", "order": 3}
    changes = {"strain": strain, "quadrature.intervals": 24}
    scene = load_scene("three_tendon").replace(changes)
    model = build_model(scene)
    bending = 5e5 * np.pi * 0.01**4 / 4
    shares = np.array([1.0, 0.5, 0.5, 0.5])
    expected = np.diag(bending * 0.3 * np.tile(shares, 2))
    np.testing.assert_allclose(model.arm.strain.stiffness, expected, atol=1e-6 * bending)
    assert Scene(**scene_to_dict(scene)) == scene


def test_fields_of_another_shape_are_refused(example, monkeypatch):
    cosines = example("own_strain")["Cosines"]
    monkeypatch.setattr(cosines, "fields", lambda self, points, borders: np.zeros((2, 3, 6)))
    changes = {"strain": {"type": "cosines", "order": 0}}
    scene = load_scene("three_tendon").replace(changes)
    with pytest.raises(
        ConfigurationError, match=r"strain has fields of shape \(2, 3, 6\): they sh"
    ):
        build_model(scene.replace({"quadrature.intervals": 4}))
