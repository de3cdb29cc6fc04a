"""Data that are read in another way than they were recorded: a finding names how, and there is none
for data that are read right."""

import functools

import numpy as np
import pytest

from soft_tendon_env import Simulation, load_scene, simulate, static_equilibrium
from soft_tendon_env.identification import Frame, Marker, MarkerSet, identify
from soft_tendon_env.identification.markers import Column
from soft_tendon_env.identification.misread import _orders, command_factors
from soft_tendon_env.identification.readings import NoHoldError, Plants
from soft_tendon_env.model.build import build_model

E = "segments.*.young_modulus"
SHIFT = np.array([0.02, -0.01, 0.03])


@functools.cache
def holds_of(name):
    """An arm, tensions, positions of two markers in holds of it, softer than it is drawn, and the
    markers."""
    changes = {"effects.gravity.acceleration": [6.0, 2.0, -5.0]}
    scene = load_scene(name).replace(changes)
    softer = {
        f"segments.{i}.young_modulus": 0.8 * segment.young_modulus
        for i, segment in enumerate(scene.segments)
    }
    length = sum(segment.length for segment in scene.segments)
    model = build_model(scene.replace(softer))
    most = 0.4 * np.array([tendon.tension_limits[1] for tendon in scene.tendons])
    rng = np.random.default_rng(5)
    shares = rng.uniform(0.0, 1.0, (10, most.size))
    tensions = shares * most
    places = np.array([0.6, 1.0]) * length
    positions = [
        model.backbone_at(static_equilibrium(model, tension).q, places)[:, :3, 3]
        for tension in tensions
    ]
    positions = np.array(positions) + 1e-3 * length * np.random.default_rng(6).normal(
        size=(10, 2, 3)
    )
    return (
        scene,
        tensions,
        positions,
        {f"m{i}": Marker(arc_length=place) for i, place in enumerate(places)},
    )


def found_of(folder, scene, tensions, positions, markers, frame=None, columns=None):
    header = [
        "hold",
        *(f"tension_{i}" for i in range(tensions.shape[1])),
        *(f"m{i}_{axis}" for i in range(2) for axis in "xyz"),
    ]
    rows = [
        [f"h{k}", *map(repr, row.tolist())]
        for k, row in enumerate(np.hstack([tensions, positions.reshape(len(tensions), -1)]))
    ]
    path = folder / "holds.csv"
    path.write_text("\n".join(",".join(row) for row in [header, *rows]))
    markers = MarkerSet(markers=markers, frame=frame or Frame(), columns=columns or {})
    return identify(scene, path, markers, [E], held_out=0, fidelity="scene", noise=None)


TURN = Frame(quaternion=(0.5, 0.1, -0.7, 0.5), translation=tuple(SHIFT))
CASES = {
    "as it is": (lambda u, p: (u, p), {}, None),
    "mirrored": (
        lambda u, p: (u, p * [1, 1, -1]),
        {},
        "x, y, z of the data read as x, y, -z (a mirror image: the frame of the data is left-h",
    ),
    "exchanged axes": (
        lambda u, p: (u, p[..., [2, 1, 0]]),
        {},
        "x, y, z of the data read as z, y, x (a mirror image",
    ),
    "turned axes": (
        lambda u, p: (u, p[..., [1, 2, 0]]),
        {},
        "x, y, z of the data read as z, x, y:",
    ),
    "mirrored in a frame": (
        lambda u, p: (u, (p - SHIFT) @ TURN.rotation * [1, -1, 1]),
        {"frame": TURN},
        "read as x, -y, z (a mirror",
    ),
    "exchanged markers": (lambda u, p: (u, p[:, ::-1]), {}, "markers m0 and m1 exchanged: markers"),
    "kilograms": (lambda u, p: (u / 9.80665, p), {}, "commands in kg"),
}


@pytest.mark.parametrize(
    "scene",
    [
        "three_tendon",
        *(
            pytest.param(name, marks=pytest.mark.slow)
            for name in ("four_tendon", "two_segment_six")
        ),
    ],
)
@pytest.mark.parametrize("case", CASES)
def test_data_that_are_misread_get_a_finding_that_names_it(tmp_path, scene, case):
    scene, tensions, positions, markers = holds_of(scene)
    change, more, text = CASES[case]
    try:
        found = found_of(tmp_path, scene, *change(tensions, positions), markers, **more).findings
    except NoHoldError as error:
        found = [str(error)]
    if text is None:
        assert not any("times better with" in finding for finding in found)
    else:
        assert any(
            words in found[0] for words in ("times better with", "fit only with")
        )  # where the arm has no such holds
        assert text in found[0]
        assert "known weight" not in " ".join(found)


@pytest.mark.parametrize(
    ("columns", "grams"),
    [
        ({}, 9.80665e-3),
        ({"tension_gauge_*": Column(unit="mm")}, 9.80665e-3),
        ({"tension_*": Column(unit="kg")}, 1e-3),
        ({"tension_1": Column(unit="mN")}, 9.80665),
    ],
)
def test_the_unit_of_commands_is_that_of_their_own_columns(columns, grams):
    """Also where a marker's name begins like that of commands."""
    scene = load_scene("three_tendon")
    markers = MarkerSet(markers={"tension_gauge": Marker(arc_length=0.3)}, columns=columns)
    model = build_model(scene)
    factors = command_factors(Plants(scene, model, markers, []))
    assert factors["commands in g"] == pytest.approx(grams, rel=1e-12)
    assert factors["commands of the other sign"] == -1.0


@pytest.fixture(scope="module")
def motion():
    """A hanging arm at the scene's numbers, and the rows of a motion of it that begins at rest:
    time, tensions, tip."""
    scene = load_scene("three_tendon").replace(
        {"effects.gravity.acceleration": [0.0, 9.81, 0.0], "integrator.step": 0.02}
    )
    model = build_model(scene.replace({"segments.0.damping": 9e3}))
    tensions = np.repeat(
        [[0.0, 0.0, 0.0], [2.0, 0.0, 0.5], [0.0, 1.0, 2.5], [1.0, 2.0, 0.0]], 15, axis=0
    )[13:]
    ran = simulate(
        model,
        tensions[:-1],
        0.02 * (len(tensions) - 1),
        0.02,
        Simulation(model).reset_at_rest(tensions[0]),
    )
    tips = ran.tip_pose[:, :3, 3]
    rows = np.column_stack([ran.time, tensions, tips])
    return scene, rows


def identify_damping(folder, scene, rows, columns=None):
    path = folder / "steps.csv"
    header = ["time", *(f"tension_{i}" for i in range(3)), "m_x", "m_y", "m_z"]
    lines = []
    for row in [header, *rows.tolist()]:
        cells = map(str, row)
        lines.append(",".join(cells))
    path.write_text("\n".join(lines))
    markers = MarkerSet(markers={"m": Marker(arc_length=0.3)}, columns=columns or {})
    return identify(scene, path, markers, ["segments.*.damping"], held_out=0, fidelity="scene")


def test_damping_is_found_from_a_motion(motion, tmp_path):
    scene, rows = motion
    found = identify_damping(tmp_path, scene, rows)
    assert found.value[0] == pytest.approx(9e3, rel=0.01)
    assert not any("Motion 'steps'" in text or "better" in text for text in found.findings)


def test_motions_that_do_not_begin_at_rest_are_told(motion, tmp_path):
    scene, rows = motion
    found = identify_damping(tmp_path, scene, rows[3:])
    (text,) = (finding for finding in found.findings if "does not begin at rest" in finding)
    assert "in the first period, at rest up to 1.5 mm" in text


def test_a_motion_that_cannot_be_simulated_says_what_to_look_at(motion, tmp_path):
    scene, rows = motion
    weak = scene.replace(
        {"segments.0.young_modulus": 2e3, "effects.gravity.acceleration": [-300.0, 900.0, 0.0]}
    )
    with pytest.raises(NoHoldError) as raised:
        identify_damping(tmp_path, weak, rows)
    text = str(raised.value)
    assert "line 2: motion 'steps' cannot be simulated" in text
    assert (
        "Its samples are 0.02 s apart, if their unit is right. Look at units and signs of the"
        " commands" in text
    )


def test_stiffness_far_from_the_drawing_is_told(tmp_path):
    """Without other loads, a wrong unit of the tensions goes into the stiffness alone."""
    scene = load_scene("three_tendon")
    model = build_model(scene)
    rng = np.random.default_rng(5)
    tensions = rng.uniform(0.0, 3.0, (6, 3))
    positions = np.array(
        [
            model.backbone_at(static_equilibrium(model, tension).q, [0.15, 0.3])[:, :3, 3]
            for tension in tensions
        ]
    )
    found = found_of(
        tmp_path,
        scene,
        tensions / 9.80665,
        positions,
        {"m0": Marker(arc_length=0.15), "m1": Marker(arc_length=0.3)},
    )
    assert found.errors[0] < 1e-6
    assert any(
        "9.8 times less than in the scene: is a unit wrong?" in finding
        for finding in found.findings
    )


def test_a_few_markers_are_tried_in_every_order_and_many_in_pairs():
    few = _orders(["a", "b", "c"])
    assert sorted(map(tuple, few.values())) == [
        *((0, 2, 1), (1, 0, 2), (1, 2, 0), (2, 0, 1), (2, 1, 0)),
    ]
    assert few["markers a, b, c read as b, c, a"] == [1, 2, 0]
    assert few["markers a and c exchanged"] == [2, 1, 0]
    many = _orders([f"m{i}" for i in range(6)])
    assert len(many) == 15
    assert many["markers m1 and m4 exchanged"] == [0, 4, 2, 3, 1, 5]
    assert len(_orders(["a", "b", "c", "d"])) == 23


def test_counts_with_a_scale_are_commands_in_their_si_unit():
    scene = load_scene("three_tendon")
    columns = {"tension_*": {"unit": "counts", "scale": 0.01}}
    markers = MarkerSet(markers={"m": Marker(arc_length=0.3)}, columns=columns)
    model = build_model(scene)
    factors = command_factors(Plants(scene, model, markers, []))
    assert factors["commands in kg"] == pytest.approx(9.80665)
    assert "commands in N" not in factors
