"""Scenes: strictness and its messages, overrides, what follows from a scene; files, those that
ship, the paper's table."""

import json

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from soft_tendon_env.effects import Effect
from soft_tendon_env.model.build import build_model
from soft_tendon_env.scene.file import SHIPPED, load_scene, save_scene, scene_names
from soft_tendon_env.scene.routing import LinearTaper, StraightRouting
from soft_tendon_env.scene.scene import (
    Base,
    Scene,
    Segment,
    Tendon,
    breakpoints,
    extrapolation_columns,
    rod_length,
    scene_to_dict,
    tendon_ends,
    tendon_offset,
)
from soft_tendon_env.scene.strain import StaticsBased
from soft_tendon_env.tools.configuration import ConfigurationError
from soft_tendon_env.tools.registry import register


def segment(**changes):
    return Segment(
        **{
            "length": 0.2,
            "young_modulus": 1e6,
            "poisson_ratio": 0.5,
            "density": 1000,
            "damping": 0,
            "radius": 0.01,
            **changes,
        }
    )


def tendon(**changes):
    return Tendon(routing=StraightRouting(offset=(0.005, 0.0)), **changes)


@pytest.fixture
def scene():
    taper = segment(length=0.3, radius=LinearTaper(base=0.01, tip=0.004))
    return Scene(
        name="test", segments=[segment(), taper], tendons=[tendon(), tendon(start=0.1, end=0.35)]
    )


REFUSED = [
    (
        {"segments.0.radius": {"type": "table", "arc_length": [0.0, 0.1], "radius": [0.01, 0.01]}},
        "should cover the segment, 0 to 0.2, but",
    ),
    ({"segments.0.curvature": [0.0, 1.0]}, "segments[0].curvature[2] is missing: it is required"),
    (
        {"tendons.1.routing.type": "helx"},
        (
            "tendons[1].routing.type is 'helx': did you mean 'helix'? valid: converging, helix,"
            " straight"
        ),
    ),
    ({"tendons.1.end": 0.05}, "tendons[1].end is 0.05: it should be greater than start, 0.1"),
    ({"tendons.0.end": 0.6}, "tendons[0].end is 0.6: it should be at most the rod's length, 0.5"),
    (
        {"tendons.0.tension_limits": [5, 5]},
        "tendons[0].tension_limits is [5, 5]: it should be (least, greatest)",
    ),
    (
        {"tendons.0.end": 1e-10},
        (
            "tendons[0] runs from 0.0 to 1e-10: it should cover more than 4e-09 of the rod's"
            " length, 0.5"
        ),
    ),
    (
        {"strain.borders": [0.6]},
        "strain.borders[0] is 0.6: it should be less than the rod's length, 0.5",
    ),
    (
        {"strain.strains": ["torsion", "twist"]},
        "strain.strains[1] is 'twist': it should be 'torsion', 'bend_y'",
    ),
    (
        {"strain.strains": ["torsion", "torsion"]},
        "should name each strain once, but repeats torsion",
    ),
    (
        {
            "strain.strains": ["bend_y"],
            "strain.passive": [{"strains": ["stretch"], "order": 0, "span": "rod"}],
        },
        "should name strains that the rod has, bend_y; not stretch",
    ),
    (
        {"integrator": {"columns": 1, "tolerance": 1e-4}},
        "integrator.tolerance is 0.0001: it needs the error estimate of at least 2",
    ),
    (
        {"base.quaternion": [0.0, 0.0, 0.0, 0.0]},
        "base.quaternion is [0.0, 0.0, 0.0, 0.0]: it should have length 1, not 0: (w, x, y, z)",
    ),
    (
        {"base.quaternion": [1.0, 0.0, 0.0]},
        "base.quaternion is [1.0, 0.0, 0.0]: it should have four numbers, not 3: (w, x, y, z)",
    ),
    (
        {"base.position": [0.0, 0.0, 800.0]},
        "coordinates should be within ±500 m, 1000 lengths of the rod; is it in mm?",
    ),
]


@pytest.mark.parametrize(("changes", "message"), REFUSED)
def test_mistakes_are_refused_by_name(scene, changes, message):
    before = scene_to_dict(scene)
    with pytest.raises(ConfigurationError) as caught:
        scene.replace(changes)
    assert message in str(caught.value)
    assert all(line.startswith("scene: ") for line in str(caught.value).splitlines())
    assert scene_to_dict(scene) == before


def test_all_mistakes_are_told_at_once():
    with pytest.raises(ConfigurationError) as caught:
        Scene(
            name="x",
            segments=[{"length": -1}],
            tendons=[{"routing": {"type": "surface"}, "stat": 0}],
        )
    told = str(caught.value)
    for key in (
        "segments[0].length is -1",
        "segments[0].density is missing",
        "tendons[0].routing.angle is missing",
    ):
        assert key in told
    assert (
        "tendons[0].stat is an unknown key (given 0): did you mean 'start'? valid: end, routing,"
        " start, tension_limits" in told
    )
    assert "at least 1 item" not in told


def test_replace_sets_dotted_keys_and_leaves_the_original(scene):
    changed = scene.replace(
        {
            "quadrature.intervals": 24,
            "segments.0.density": 5.0,
            "tendons[1].end": None,
            "strain.passive_coordinates": "raw",
            "effects.gravity.acceleration": np.array([0, 0, -9.81]),
        }
    )
    assert (changed.quadrature.intervals, changed.segments[0].density, changed.tendons[1].end) == (
        24,
        5.0,
        None,
    )
    assert changed.strain.passive_coordinates == "raw"
    assert changed.effects.gravity.acceleration == (
        0.0,
        0.0,
        -9.81,
    )
    assert scene.quadrature.intervals is None
    assert scene.effects.gravity is None
    assert scene.tendons[1].end == 0.35
    assert changed.replace({"effects.gravity": None}).effects == scene.effects


def test_an_effect_from_outside_is_a_table_of_scenes(forgotten):
    class Wind(Effect):
        speed: float

        def parameters(self, rod):
            return self.speed

    with pytest.raises(
        ConfigurationError,
        match="^scene: effects.wind is an unknown key .*valid: .*gravity, .*tip_load",
    ):
        load_scene("paper").replace({"effects.wind.speed": 1.0})
    assert register("effect", "wind")(Wind) is Wind
    assert register("effect", "wind")(Wind) is Wind
    scene = load_scene("paper").replace(
        {"effects.wind.speed": 1, "effects.gravity.acceleration": [0, 0, 1]}
    )
    assert scene.effects.wind == Wind(speed=1.0)
    assert list(scene.effects.chosen()) == [
        "gravity",
        "wind",
    ]
    assert scene_to_dict(scene)["effects"]["wind"] == {"speed": 1.0}
    assert Scene(**scene_to_dict(scene)) == scene
    assert load_scene("paper").effects.wind is None
    with pytest.raises(
        TypeError,
        match=(
            "the effect 'wind' has no kernel for its parameters: decorate one with"
            " @adds_wrench.float."
        ),
    ):
        build_model(scene)


def test_breakpoints_are_every_end_and_border_once(scene):
    np.testing.assert_allclose(breakpoints(scene), [0, 0.1, 0.2, 0.35, 0.5], rtol=1e-15)
    close = scene.replace(
        {
            "strain": StaticsBased(borders=[0.42, 0.2 + 1e-12, 0.35 - 1e-12]),
            "tendons.0.end": 0.5 - 1e-12,
        }
    )
    np.testing.assert_allclose(breakpoints(close), [0, 0.1, 0.2, 0.35, 0.42, 0.5], atol=1e-11)
    assert breakpoints(close)[0] == 0
    assert breakpoints(close)[-1] == rod_length(close)


@pytest.mark.parametrize(
    ("changes", "columns"),
    [
        ({}, 3),
        ({"segments.0.damping": 0.0}, 2),
        ({"segments.0.damping": 0.0, "integrator.columns": 4}, 4),
        ({"integrator.tolerance": 1e-4}, 6),
        ({"integrator.tolerance": 1e-4, "segments.0.damping": 1.0}, 2),
        # torsion of a material that does not shear is damped less than bending
        ({"segments.0.damping": 300.0, "segments.0.poisson_ratio": 0.5}, 3),
        ({"segments.0.damping": 300.0, "segments.0.poisson_ratio": -0.9}, 2),
        (
            {
                "segments.0.damping": 300.0,
                "segments.0.poisson_ratio": -0.9,
                "strain.strains": ["bend_y", "bend_z"],
            },
            3,
        ),
    ],
)
def test_extrapolation_columns_follow_the_damping_unless_given(changes, columns):
    assert extrapolation_columns(load_scene("paper").replace(changes)) == columns


@pytest.mark.parametrize("name", scene_names())
def test_shipped_scene_loads_and_round_trips(name, tmp_path):
    scene = load_scene(name)
    assert scene.name == name
    assert scene.description
    assert (SHIPPED / f"{name}.toml").read_text(encoding="utf-8").startswith("# ")
    step = 0.002 if name == "catheter" else 0.02
    assert (scene.integrator.step, extrapolation_columns(scene)) == (step, 3)
    save_scene(scene, tmp_path / "copy.toml")
    assert load_scene(tmp_path / "copy.toml") == scene
    assert load_scene(str(SHIPPED / f"{name}.toml")) == scene
    assert json.loads(json.dumps(scene_to_dict(scene))) == scene_to_dict(scene)
    assert [path.name for path in tmp_path.iterdir()] == ["copy.toml"]


def test_paper_tendons_follow_the_papers_table():
    scene = load_scene("paper")
    x = np.linspace(0.0, 0.5, 31)
    r = 0.03 - 0.01 * x
    r_t = 0.02
    r_m = 0.025
    turn = 4 * np.pi * x
    s = np.sin(np.pi / 6)
    c = np.cos(np.pi / 6)
    table = [
        (r, 0 * x),
        (-r * s, r * c),
        (-r * s, -r * c),
        (r_t * np.sin(turn), r_t * np.cos(turn)),
        (r_t * np.sin(turn), -r_t * np.cos(turn)),
        (-r, 0 * x),
        (r * s, -r * c),
        (r * s, r * c),
        (r_m * np.sin(np.pi / 2 + turn), r_m * np.cos(np.pi / 2 + turn)),
        (-r_m * np.sin(np.pi / 2 + turn), r_m * np.cos(np.pi / 2 + turn)),
    ]
    assert [tendon_ends(scene, tendon) for tendon in scene.tendons] == [(0.0, 1.0)] * 5 + [
        (0.0, 0.5)
    ] * 5
    for tendon, yz in zip(scene.tendons, table, strict=True):
        np.testing.assert_allclose(
            tendon_offset(scene, tendon, x)[0], np.column_stack(yz), atol=1e-16
        )


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (b"", "segments is missing: it is required"),
        (b"name = 2024-01-01", "name is datetime.date.*: it should be a valid string"),
    ],
)
def test_bad_file_is_named_with_its_mistake(tmp_path, content, message):
    path = tmp_path / "bad.toml"
    path.write_bytes(content)
    with pytest.raises(ConfigurationError, match=message) as caught:
        load_scene(path)
    assert all(line.startswith(f"{path}: ") for line in str(caught.value).splitlines())


@pytest.mark.parametrize("rotation", [(0.0, 0.0, 0.0), (30.0, -50.0, 70.0), (0.0, 200.0, 0.0)])
def test_a_base_is_turned_by_its_quaternion_and_then_about_the_axes_of_the_world(rotation):
    position = (1.0, 2.0, 3.0)
    base = Base(position=position, quaternion=(0.5, 0.1, -0.7, 0.5), rotation=rotation)
    # scipy has the real part last
    first = Rotation.from_quat([0.1, -0.7, 0.5, 0.5])
    further = Rotation.from_rotvec(rotation, degrees=True)
    expected = np.eye(4)
    expected[:3, :3] = (further * first).as_matrix()
    expected[:3, 3] = position
    np.testing.assert_allclose(base.pose, expected, atol=1e-12)
