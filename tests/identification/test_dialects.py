"""Logs as people have them: dialects of tables, names and units of columns, times with jitter and gaps; the right numbers, or what to
change."""

import numpy as np
import pytest

from soft_tendon_env.identification import Marker, MarkerSet
from soft_tendon_env.identification.recordings import clusters, read_recordings, split
from soft_tendon_env.scene.file import load_scene

HEADER = ["hold", "tension_0", "tension_1", "tension_2", "m_x", "m_y", "m_z"]
NUMBERS = np.array([[0.5, 0.0, 1.25, 0.28, 0.031, -0.0045], [2.0, 1.5, 0.0, 0.251, -0.08, 0.06], [0.0, 0.0, 3.75, 0.2125, 0.0, 0.11]])
MARKERS = MarkerSet(markers={"m": Marker(arc_length=0.3)})


def table(separator=",", mark=".", header=HEADER, numbers=NUMBERS, names=("a", "b", "c")):
    """Text of holds."""
    lines = [[name, *(f"{value:.12g}".replace(".", mark) for value in row)] for name, row in zip(names, numbers, strict=True)]
    return "\n".join(separator.join(cells) for cells in [header, *lines]) + "\n"


def read(tmp_path, content, markers=MARKERS, scene="three_tendon"):
    path = tmp_path / "log.csv"
    path.write_bytes(content if isinstance(content, bytes) else content.encode())
    return read_recordings([path], load_scene(scene), markers)


@pytest.mark.cases(
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
    np.testing.assert_array_equal([[*one.command[0], *one.positions[0, 0]] for one in found], NUMBERS)


@pytest.mark.cases(
    "columns, factors, header",
    [
        ({"m_*": {"unit": "mm"}, "tension_*": {"unit": "g"}}, [1e3 / 9.80665] * 3 + [1e3] * 3, HEADER),
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
    np.testing.assert_allclose([[*recording.command[0], *recording.positions[0, 0]] for recording in found], NUMBERS, rtol=1e-11)
    again = markers.with_offsets(markers.offsets)
    assert again.columns == markers.columns


def test_rows_of_servos_in_mm_with_labels_are_holds_in_groups(tmp_path):
    """As a laboratory wrote them: epoch seconds that name rows, servos in an order of their own, patterns of motion."""
    header = "timestamp,pattern_label,servo_7_mm,servo_2_mm,servo_5_mm,tip_x,tip_y,tip_z"
    rows = [f"{1778538602.5 + 0.6 * i:.6f},rep1_dir{60 * (i // 2)}_pull,{-i},{0.5 * i},{2 * i},{i},-2.5,{299 - i}" for i in range(6)]
    servos = {f"displacement_{i}": {"name": f"servo_{servo}_mm", "unit": "mm", "sign": sign} for i, servo, sign in [(0, 5, 1), (1, 7, -1)]}
    columns = {**servos, "displacement_2": {"name": "servo_2_mm", "unit": "mm"}, "tip_*": {"unit": "mm"}, "hold": {"name": "timestamp"}}
    driven = load_scene("three_tendon").replace({"effects.tendon_elasticity": {"stiffness": 3e3, "displacement_limits": [-0.01, 0.02]}})
    turned = {"markers": {"tip": {"arc_length": 0.3}}, "frame": {"quaternion": [0.5, 0.5, 0.5, 0.5]}}
    markers = MarkerSet.parse({**turned, "columns": {**columns, "group": {"name": "pattern_label"}}}, "test")
    (tmp_path / "log.csv").write_text("\n".join([header, *rows]) + "\n")
    found = read_recordings([tmp_path / "log.csv"], driven, markers)
    assert [one.name for one in found[:2]] == ["1778538602.500000", "1778538603.100000"] and not any(one.period for one in found)
    np.testing.assert_allclose([one.command[0] for one in found], 1e-3 * np.outer(range(6), [2.0, 1.0, 0.5]), rtol=1e-12)
    np.testing.assert_allclose(found[3].positions[0, 0], [0.296, 0.003, -0.0025], rtol=1e-12)
    assert clusters(found).tolist() == [0, 0, 1, 1, 2, 2] and [len(part) for part in split(found, "0.34")] == [4, 2]


@pytest.mark.cases(
    "content, message",
    [
        (table(";", header=[*HEADER[:-1], "z"]), "line 1 (separated by ';'): there is no column m_z"),
        (table(";", ",").replace("0,5", "0.5"), "numbers should have one decimal mark, and no others"),
        (
            table(numbers=NUMBERS * [1, 1, 1, 1e3, 1e3, 1e3]),
            '0.3 m; is it in mm? [columns] of the markers\' file says so: "m_*" = { unit = "mm" }',
        ),
        (table(numbers=NUMBERS * [1, 1, 1, 1e-3, 1e-3, 1e-3]), "is the arm's length or the unit wrong? Positions are in m"),
        (table().replace("0.5", "-0.5"), "line 2: tension_0 is -0.5 N: the scene's tension_limits are 0 to 5 N"),
        (table().replace("0.031", "0.03l"), "line 2: m_y is '0.03l'"),
        (table().encode("utf-16"), "log.csv cannot be read as text in UTF-8: "),
    ],
)
def test_what_cannot_be_read_is_told_with_its_place(tmp_path, content, message):
    with pytest.raises(ValueError) as raised:
        read(tmp_path, content)
    assert message in str(raised.value) and "\n" not in str(raised.value)


def motion(times, tensions=None):
    """Text of samples at times."""
    tensions = np.tile(NUMBERS[:, :3], (len(times), 1))[: len(times)] if tensions is None else tensions
    moving = np.array([0.28, 0.0, 0.0]) - 0.1 * np.arange(len(times))[:, None] / len(times) * [1.0, 0.2, -0.3]
    rows = [[repr(time), *map(str, u), *map(str, p)] for time, u, p in zip(times, tensions, moving.tolist(), strict=True)]
    return "\n".join(",".join(row) for row in [["time", *HEADER[1:]], *rows]) + "\n"


@pytest.mark.cases(
    "period, begin, unit",
    [(0.01, 1.7634e9, "s"), (20.0, 1.7634e12, "ms"), (5000, 1763400000000000, "us"), (4000000, 1763400000000000000, "ns")],
)
def test_times_are_read_in_their_unit(tmp_path, period, begin, unit):
    times = [begin + period * (k + 0.1 * (k % 2)) for k in range(20)]  # with jitter
    markers = MarkerSet(markers=MARKERS.markers, columns={"time": {"unit": unit}})
    (found,) = read(tmp_path, motion(times), markers)
    assert found.period == pytest.approx(period * {"s": 1, "ms": 1e-3, "us": 1e-6, "ns": 1e-9}[unit], rel=2e-3)
    if unit in ("us", "ns"):
        with pytest.raises(ValueError, match=f'apart in time: is it in {unit}. .columns. .* time = . unit = "{unit}"'):
            read(tmp_path, motion(times))


@pytest.mark.cases(
    "times, message",
    [
        ([0.0, 0.01, 0.02, 0.02, 0.03], "line 5: time is 0.02 s after 0.02 s: it should be a number, and grow"),
        (
            [0.0, 0.01, 0.02, 0.03, 0.06, 0.07],
            "line 6: time goes on by 0.03 s: it should in equal steps, which are 0.01 s in the middle; a row",
        ),
        ([1.7634e12, 1.7634e12 + 20, 1.7634e12 + 40], "line 2: samples are 20 s apart in time: is it in ms?"),
        ([0.0, 10.0, 20.0], "line 2: samples are 10 s apart in time: is it in ms?"),
        ([0.0], "line 2: a motion should have at least two samples"),
    ],
)
def test_times_in_no_equal_steps_are_refused(tmp_path, times, message):
    with pytest.raises(ValueError) as raised:
        read(tmp_path, motion(times))
    assert message in str(raised.value)


@pytest.mark.cases("text", ["nan", "NaN", "", "NA", "null", "None", "0"])
def test_cells_without_a_number_are_markers_that_were_not_seen(tmp_path, text):
    found = read(tmp_path, table().replace("0.251,-0.08,0.06", ",".join([text] * 3)))
    assert np.isnan(found[1].positions).all() and np.isfinite(found[2].positions).all()
