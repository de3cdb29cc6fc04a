"""Recordings of real arms in the dialects that people have: what is read, and what cannot be used,
in one line that says where."""

import numpy as np
import pytest

from soft_tendon_env import ConfigurationError, load_scene
from soft_tendon_env.identification import Marker, MarkerSet, load_markers
from soft_tendon_env.identification.clusters import clusters, same_commands, split
from soft_tendon_env.identification.recordings import (
    Recording,
    check_commands,
    read_recordings,
)

HEADER = ["hold", "tension_0", "tension_1", "tension_2", "m_x", "m_y", "m_z"]
NUMBERS = np.array(
    [
        [0.5, 0.0, 1.25, 0.28, 0.031, -0.0045],
        [2.0, 1.5, 0.0, 0.251, -0.08, 0.06],
        [0.0, 0.0, 3.75, 0.2125, 0.0, 0.11],
    ]
)
MARKERS = MarkerSet(markers={"m": Marker(arc_length=0.3)})


def test_holds_are_read_in_the_scenes_frame(arm, holds, placed, tensions):
    found = read_recordings([holds], arm, placed)
    assert [recording.name for recording in found[:2]] == ["holds0", "holds1"]
    assert not any(recording.period for recording in found)
    assert np.allclose([recording.command[0] for recording in found], tensions)
    assert all(
        np.linalg.norm(recording.positions[0], axis=1) @ [1, 0, 0]
        < 0.12
        < recording.positions[0, 2, 0]
        for recording in found
    )


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (
            "[markers.a]\narc_length = 0.9",
            "markers.a.arc_length is 0.9: it should be at most the rod's length, 0.3 m",
        ),
        (
            "[markers.a]\narc_length = 90",
            (
                "markers.a.arc_length is 90: it should be at most the rod's length, 0.3 m; is it"
                " in mm?"
            ),
        ),
        (
            "[markers.a]\narc_length = 0.1\noffset = [0, 0, 12]",
            "markers.a.offset is 12: it should be at most the rod's length",
        ),
        (
            "[markers.a]\narc_length = 0.1\n[columns.a_x]\nsign = 2",
            "columns.a_x.sign is 2: it should be 1 or -1",
        ),
        (
            "[markers.a]\narc_length = 0.1\n[frame]\nquaternion = [1, 1, 0, 0]",
            "should have length 1, not 1.414",
        ),
    ],
)
def test_bad_markers_are_told(arm, tmp_path, text, message):
    path = tmp_path / "markers.toml"
    path.write_text(text)
    with pytest.raises(ConfigurationError) as raised:
        load_markers(path, arm)
    assert message in str(raised.value)
    assert str(path) in str(raised.value)


def test_a_share_or_a_column_is_held_out(arm, holds, placed):
    found = read_recordings([holds], arm, placed)
    assert [len(part) for part in split(found)] == [12, 4]
    assert [len(part) for part in split(found, "0")] == [16, 0]
    assert len(split(found, "tension_0")[1]) == 10


@pytest.mark.parametrize(
    ("held_out", "message"),
    [
        ("-1", "a share from 0"),
        ("weight", "no column of that name with numbers"),
        ("1.0", "a share from 0 to below 1"),
    ],
)
def test_bad_shares_are_told(arm, holds, placed, held_out, message):
    with pytest.raises(ValueError, match="held_out is") as raised:
        split(read_recordings([holds], arm, placed), held_out)
    assert message in str(raised.value)


def recordings_of(*commands, period=0.0):
    """Recordings of commands, a motion for each list of them."""
    return [
        Recording(f"{i}", "simulated", np.atleast_2d(command), np.full((1, 1, 3), i), period, {})
        for i, command in enumerate(commands)
    ]


@pytest.mark.parametrize(
    ("commands", "groups"),
    [
        ([[1.0, 0.0], [1.004, 0.001], [2.0, 0.0], [0.996, 0.0], [1.0, 0.1]], [0, 0, 1, 0, 2]),
        ([[0.001, 0.0], [0.00101, 0.0], [0.002, 0.0], [0.0, 0.002]], [0, 0, 1, 2]),
        ([[2.0, 1.0], [2.002, 1.0], [1.999, 1.001]], [0, 0, 0]),
        ([[[0.0], [1.0], [1.0]], [[0.0], [1.01], [1.0], [1.0]], [[0.0], [0.0], [1.0]]], [0, 0, 1]),
        ([[0.1 * i] for i in range(11)], [*range(11)]),
    ],
)
def test_repeats_of_the_same_commands_are_found(commands, groups):
    assert same_commands(recordings_of(*commands)).tolist() == groups


@pytest.mark.parametrize(("share", "count"), [("0.25", 4), ("0.5", 8)])
def test_repeats_stay_together_when_some_are_held_out(share, count):
    rng = np.random.default_rng(0)
    tensions = rng.uniform(0.0, 5.0, (4, 3))
    parts = split(
        recordings_of(
            *(np.tile(tensions, (4, 1)) + 0.01 * np.random.default_rng(1).uniform(size=(16, 3)))
        ),
        share,
    )
    seen, unseen = ({int(one.name) % 4 for one in part} for part in parts)
    assert len(parts[1]) == count
    assert not seen & unseen


def test_the_unit_of_commands_is_guessed_by_the_largest():
    """A ramp from zero in grams-force: 400 of them are 3.9 N of the 5 N that the arm takes."""
    (ramp,) = recordings_of([[0.0, 0.0, 0.0], [0.0, 400.0, 0.0]], period=0.1)
    with pytest.raises(ValueError, match=r"tension_1 is 400 N: .* to 5 N; is it in .*g"):
        check_commands(ramp, load_scene("three_tendon"))


def test_displacements_beyond_their_limits_are_told(arm, holds, placed, tmp_path):
    path = tmp_path / "pulled.csv"
    path.write_text(holds.read_text().replace("tension_", "displacement_"))
    driven = arm.replace(
        {"effects.tendon_elasticity": {"stiffness": 3e3, "displacement_limits": [-0.01, 0.03]}}
    )
    with pytest.raises(
        ValueError,
        match=(
            "m: the scene's displacement_limits are -0.01 to 0.03 m; is it in cm or mm. .columns."
        ),
    ):
        read_recordings([path], driven, placed)


def table(separator=",", mark=".", header=HEADER, numbers=NUMBERS, names=("a", "b", "c")):
    """Text of holds."""
    lines = [
        [name, *(f"{value:.12g}".replace(".", mark) for value in row)]
        for name, row in zip(names, numbers, strict=True)
    ]
    return "\n".join(separator.join(cells) for cells in [header, *lines]) + "\n"


def read(tmp_path, content, markers=MARKERS, scene="three_tendon"):
    path = tmp_path / "log.csv"
    path.write_bytes(content if isinstance(content, bytes) else content.encode())
    return read_recordings([path], load_scene(scene), markers)


@pytest.mark.parametrize(
    "content",
    [
        table().encode("utf-8-sig"),
        table(";", ","),
        table("\t", ","),
        table("   "),
        "sep=;\n" + table(";"),
        "# rig 2, run 7\n\n% in N, m\n" + table(),
        "# " + table(" "),
        table().replace("\n", "\n,,,,,,\n"),
        table().replace("\n", ",,\n"),
        table().replace("\n", ",anna\n").replace("anna", "operator", 1),
        table(header=[name.upper() for name in HEADER]),
        table().replace("0.5", " +5e-1 ").replace("a,", '"a",'),
    ],
)
def test_dialects_give_the_same_numbers(tmp_path, content):
    found = read(tmp_path, content)
    assert [one.name for one in found] == ["a", "b", "c"]
    np.testing.assert_array_equal(
        [[*one.command[0], *one.positions[0, 0]] for one in found], NUMBERS
    )


@pytest.mark.parametrize(
    ("columns", "factors", "header"),
    [
        (
            {"m_*": {"unit": "mm"}, "tension_*": {"unit": "g"}},
            [1e3 / 9.80665] * 3 + [1e3] * 3,
            HEADER,
        ),
        (
            {
                "m_*": {"name": "pose.*", "unit": "cm"},
                "m_y": {"name": "pose.y", "sign": -1},
                "tension_*": {"name": "effort[*]", "unit": "kg"},
            },
            [1 / 9.80665] * 3 + [100, -1, 100],
            ["hold", *(f"effort[{i}]" for i in range(3)), *(f"pose.{axis}" for axis in "xyz")],
        ),
    ],
)
def test_columns_have_names_units_and_signs(tmp_path, columns, factors, header):
    markers = MarkerSet(markers=MARKERS.markers, columns=columns)
    found = read(tmp_path, table(header=header, numbers=NUMBERS * factors), markers)
    np.testing.assert_allclose(
        [[*recording.command[0], *recording.positions[0, 0]] for recording in found],
        NUMBERS,
        rtol=1e-11,
    )
    again = markers.with_offsets(markers.offsets)
    assert again.columns == markers.columns


def test_rows_of_servos_in_mm_with_labels_are_holds_in_groups(tmp_path):
    """As a laboratory wrote them: epoch seconds that name rows, servos in an order of their own,
    patterns of motion."""
    header = "timestamp,pattern_label,servo_7_mm,servo_2_mm,servo_5_mm,tip_x,tip_y,tip_z"
    rows = [
        f"{1778538602.5 + 0.6 * i:.6f},rep1_dir{60 * (i // 2)}_pull,{-i},{0.5 * i},{2 * i},"
        f"{i},-2.5,{299 - i}"
        for i in range(6)
    ]
    servos = {
        f"displacement_{i}": {"name": f"servo_{servo}_mm", "unit": "mm", "sign": sign}
        for i, servo, sign in [(0, 5, 1), (1, 7, -1)]
    }
    columns = {
        **servos,
        "displacement_2": {"name": "servo_2_mm", "unit": "mm"},
        "tip_*": {"unit": "mm"},
        "hold": {"name": "timestamp"},
    }
    driven = load_scene("three_tendon").replace(
        {"effects.tendon_elasticity": {"stiffness": 3e3, "displacement_limits": [-0.01, 0.02]}}
    )
    turned = {
        "markers": {"tip": {"arc_length": 0.3}},
        "frame": {"quaternion": [0.5, 0.5, 0.5, 0.5]},
    }
    markers = MarkerSet.parse(
        {**turned, "columns": {**columns, "group": {"name": "pattern_label"}}}, "test"
    )
    (tmp_path / "log.csv").write_text("\n".join([header, *rows]) + "\n")
    found = read_recordings([tmp_path / "log.csv"], driven, markers)
    assert [one.name for one in found[:2]] == [
        "1778538602.500000",
        "1778538603.100000",
    ]
    assert not any(one.period for one in found)
    np.testing.assert_allclose(
        [one.command[0] for one in found], 1e-3 * np.outer(range(6), [2.0, 1.0, 0.5]), rtol=1e-12
    )
    np.testing.assert_allclose(found[3].positions[0, 0], [0.296, 0.003, -0.0025], rtol=1e-12)
    assert clusters(found).tolist() == [0, 0, 1, 1, 2, 2]
    assert [len(part) for part in split(found, "0.34")] == [4, 2]


def motion(times, tensions=None):
    """Text of samples at times."""
    tensions = (
        np.tile(NUMBERS[:, :3], (len(times), 1))[: len(times)] if tensions is None else tensions
    )
    moving = np.array([0.28, 0.0, 0.0]) - 0.1 * np.arange(len(times))[:, None] / len(times) * [
        1.0,
        0.2,
        -0.3,
    ]
    rows = [
        [repr(time), *map(str, u), *map(str, p)]
        for time, u, p in zip(times, tensions, moving.tolist(), strict=True)
    ]
    header = ["time", *HEADER[1:]]
    lines = [",".join(row) for row in [header, *rows]]
    return "\n".join(lines) + "\n"


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (
            table(";", header=[*HEADER[:-1], "z"]),
            "line 1 (separated by ';'): there is no column m_z",
        ),
        (
            table(";", ",").replace("0,5", "0.5"),
            "numbers should have one decimal mark, and no others",
        ),
        (
            table(numbers=NUMBERS * [1, 1, 1, 1e3, 1e3, 1e3]),
            '0.3 m; is it in mm? [columns] of the markers\' file says so: "m_*" = { unit = "mm" }',
        ),
        (
            table(numbers=NUMBERS * [1, 1, 1, 1e-3, 1e-3, 1e-3]),
            "is the arm's length or the unit wrong? Positions are in m",
        ),
        (
            table().replace("0.5", "-0.5"),
            "line 2: tension_0 is -0.5 N: the scene's tension_limits are 0 to 5 N",
        ),
        (
            table().replace("0.031", "0.03l"),
            "line 2: m_y is '0.03l': it should be a finite number, or empty where there is none",
        ),
        (
            table(header=[*HEADER[:3], "tension_0", *HEADER[4:]]),
            "column tension_0 is there 2 times",
        ),
        (
            table().replace("3.75", "306"),
            (
                "line 4: tension_2 is 306 N: the scene's tension_limits are 0 to 5 N; is it in mN"
                " or g? [columns] of"
            ),
        ),
        (
            table(names="aab"),
            "line 3: hold 'a' has a second row: samples of a motion need a column time",
        ),
        (table(names="aba"), "hold 'a' is there 2 times"),
        (table().encode("utf-16"), "log.csv cannot be read as text in UTF-8: "),
        (
            motion([0.0, 0.01, 0.02, 0.02, 0.03]),
            "line 5: time is 0.02 s after 0.02 s: it should be a number, and grow",
        ),
        (
            motion([0.0, 0.01, 0.02, 0.03, 0.06, 0.07]),
            (
                "line 6: time goes on by 0.03 s: it should in equal steps, which are 0.01 s in the"
                " middle; a row"
            ),
        ),
        (
            motion([1.7634e12, 1.7634e12 + 20, 1.7634e12 + 40]),
            "line 2: samples are 20 s apart in time: is it in ms?",
        ),
        (motion([0.0, 10.0, 20.0]), "line 2: samples are 10 s apart in time: is it in ms?"),
        (motion([0.0]), "line 2: a motion should have at least two samples"),
    ],
)
def test_what_cannot_be_read_is_told_with_its_place(tmp_path, content, message):
    with pytest.raises(ValueError) as raised:
        read(tmp_path, content)
    assert message in str(raised.value)
    assert "\n" not in str(raised.value)


@pytest.mark.parametrize(
    ("period", "begin", "unit"),
    [
        (0.01, 1.7634e9, "s"),
        (20.0, 1.7634e12, "ms"),
        (5000, 1763400000000000, "us"),
        (4000000, 1763400000000000000, "ns"),
    ],
)
def test_times_are_read_in_their_unit(tmp_path, period, begin, unit):
    times = []
    for k in range(20):
        jitter = 0.1 * (k % 2)
        time = begin + period * (k + jitter)
        times.append(time)
    markers = MarkerSet(markers=MARKERS.markers, columns={"time": {"unit": unit}})
    (found,) = read(tmp_path, motion(times), markers)
    assert found.period == pytest.approx(
        period * {"s": 1, "ms": 1e-3, "us": 1e-6, "ns": 1e-9}[unit], rel=2e-3
    )
    if unit in ("us", "ns"):
        with pytest.raises(
            ValueError,
            match=f'apart in time: is it in {unit}. .columns. .* time = . unit = "{unit}"',
        ):
            read(tmp_path, motion(times))


@pytest.mark.parametrize("text", ["nan", "NaN", "", "NA", "null", "None", "0"])
def test_cells_without_a_number_are_markers_that_were_not_seen(tmp_path, text):
    found = read(tmp_path, table().replace("0.251,-0.08,0.06", ",".join([text] * 3)))
    assert np.isnan(found[1].positions).all()
    assert np.isfinite(found[2].positions).all()
