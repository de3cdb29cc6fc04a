"""Files as trackers export them: header blocks, lost tools, times by ISO 8601, counts, arrays."""

import numpy as np
import pytest
from scipy.io import savemat

from soft_tendon_env import ConfigurationError, load_scene
from soft_tendon_env.identification import Marker, MarkerSet
from soft_tendon_env.identification.recordings import read_recordings

MARKERS = {"a": Marker(arc_length=0.15), "b": Marker(arc_length=0.3)}
TENSION = np.array([[0.5, 0.0, 1.25], [2.0, 1.5, 0.0], [0.25, 0.0, 3.0]])
POSITION = np.array(
    [
        [[0.14, 0.02, -0.01], [0.28, 0.031, -0.0045]],
        [[0.12, -0.05, 0.03], [0.251, -0.08, 0.06]],
        [[0.11, 0.0, 0.07], [0.2125, 0.01, 0.11]],
    ]
)
NAMED = {
    "hold": {"name": "Frame"},
    "tension_*": {"name": "f*"},
    "a_*": {"name": "rig:a *"},
    "b_*": {"name": "rig:b *"},
}
FORCES = ",f0,f1,f2"


def cells(*columns):
    """Rows of columns side by side, as text."""
    rows = np.hstack([np.asarray(column).reshape(3, -1) for column in columns])
    return [",".join(f"{value:.9g}" for value in row) for row in rows.tolist()]


def motive(unit="Millimeters", factor=1e3):
    """A take of OptiTrack Motive, with a rigid body between the markers and the loads."""
    body = np.full((3, 7), 0.5)
    rows = cells(factor * POSITION, body, TENSION)
    return [
        f"Format Version,1.23,Take Name,Take 7,Capture Frame Rate,120,Length Units,{unit}",
        "",
        ",Type" + ",Marker" * 6 + ",Rigid Body" * 7 + ",,,",
        ",Name" + ",rig:a" * 3 + ",rig:b" * 3 + ",mount" * 7 + ",,,",
        ",ID" + ",A1" * 3 + ",B2" * 3 + ",C3" * 7 + ",,,",
        "," + ",Position" * 6 + ",Rotation" * 4 + ",Position" * 3 + ",,,",
        "Frame,Time (Seconds)" + ",X,Y,Z" * 2 + ",X,Y,Z,W,X,Y,Z" + FORCES,
        *(f"{i},{i / 120:.6f},{row}" for i, row in enumerate(rows)),
    ]


def nexus(unit="mm", factor=1e3):
    """An export of Vicon Nexus: loads of devices first, outputs of a model last."""
    rows = cells(factor * POSITION, TENSION)
    return [
        *("Devices", "1000", ",,Plate", "Frame,Sub Frame,Fx", ",,N"),
        *(f"{i},{k},{0.1 * k}" for i in range(20) for k in range(10)),
        *("", "Trajectories", "100", ",,rig:a,,,rig:b,,,,,"),
        "Frame,Sub Frame,X,Y,Z,X,Y,Z" + FORCES,
        f",,{','.join([unit] * 6)},N,N,N",
        *(f"{i + 1},0,{row}" for i, row in enumerate(rows)),
        *("", "Model Outputs", "100", ",,knee", "Frame,Sub Frame,X", ",,deg", "1,0,3.5"),
    ]


def read(tmp_path, lines, columns, name="log.csv"):
    path = tmp_path / name
    path.write_text("\n".join(lines) + "\n")
    markers = MarkerSet(markers=MARKERS, columns=columns)
    scene = load_scene("three_tendon")
    return read_recordings([path], scene, markers)


def assert_holds(recordings):
    np.testing.assert_allclose([hold.command[0] for hold in recordings], TENSION, atol=1e-9)
    np.testing.assert_allclose([hold.positions[0] for hold in recordings], POSITION, atol=1e-9)


@pytest.mark.parametrize(
    "lines",
    [motive(), motive("Meters", 1.0), nexus(), nexus("cm", 1e2)],
    ids=["Motive in mm", "Motive in m", "Nexus in mm", "Nexus in cm"],
)
def test_exports_of_trackers_are_read_in_the_units_that_they_give(tmp_path, lines):
    assert_holds(read(tmp_path, lines, NAMED))


@pytest.mark.parametrize("lines", [motive(), nexus()], ids=["Motive", "Nexus"])
def test_a_unit_that_the_file_contradicts_is_told(tmp_path, lines):
    columns = {**NAMED, "b_*": {"name": "rig:b *", "unit": "cm"}}
    with pytest.raises(ValueError, match="is in mm, says the file, and columns.b_.*unit is 'cm'"):
        read(tmp_path, lines, columns)


def plain(hold=("h", "i", "j"), label="hold", positions=POSITION, tension=TENSION):
    """Lines of a plain table."""
    names = [f"{marker}_{axis}" for marker in "ab" for axis in "xyz"]
    header = [label, *names, *(f"tension_{i}" for i in range(3))]
    rows = cells(positions, tension)
    return [
        ",".join(header),
        *(f"{name},{row}" for name, row in zip(hold, rows, strict=True)),
    ]


@pytest.mark.parametrize("sign", [-3.697314e28, -3.697e28])
@pytest.mark.parametrize("unit", ["m", "mm"])
def test_a_tool_that_the_tracker_lost_was_not_seen(tmp_path, sign, unit):
    factor = 1e3 if unit == "mm" else 1.0
    positions = factor * POSITION
    positions[1, 0] = sign
    columns = {f"{marker}_*": {"unit": unit} for marker in "ab"}
    recordings = read(tmp_path, plain(positions=positions), columns)
    assert np.isnan(recordings[1].positions[0, 0]).all()
    (begun,) = recordings[0].positions
    np.testing.assert_allclose(begun, POSITION[0])
    (after,) = recordings[1].positions
    np.testing.assert_allclose(after[1], POSITION[1, 1])


@pytest.mark.parametrize(
    "times",
    [
        [
            "2026-05-11T17:59:59.970+02:00",
            "2026-05-11T17:59:59.990+02:00",
            "2026-05-11T18:00:00.010+02:00",
        ],
        ["2026-05-11 23:59:59.97", "2026-05-11 23:59:59.99", "2026-05-12 00:00:00.01"],
        ["09:59:59.97", "09:59:59.99", "10:00:00.01"],
    ],
    ids=["with a zone", "without", "of day"],
)
def test_times_by_iso_8601_are_seconds_whatever_the_unit(tmp_path, times):
    still = np.repeat(POSITION[:1], 3, axis=0)
    for unit in ("s", "ms"):
        columns = {"time": {"unit": unit}}
        (motion,) = read(tmp_path, plain(times, "time", still), columns)
        assert motion.period == pytest.approx(0.02, rel=1e-4)


def test_a_time_that_is_none_is_told(tmp_path):
    with pytest.raises(ValueError, match="line 3: time is '25:10:99': it should be a number, or"):
        read(tmp_path, plain(["01:00", "25:10:99", "02:00"], "time"), {})


def test_columns_of_one_name_are_told_apart_by_their_order(tmp_path):
    """As NDI's programs write them: the same names for each tool."""
    rows = cells(POSITION[:, 0], POSITION[:, 1], TENSION)
    header = f"Frame,Tx,Ty,Tz,Tx,Ty,Tz{FORCES}"
    lines = [header, *(f"{i},{row}" for i, row in enumerate(rows))]
    columns = {**NAMED, "a_*": {"name": "T*.0"}, "b_*": {"name": "T*.1"}}
    assert_holds(read(tmp_path, lines, columns))
    untold = {**columns, "a_*": {"name": "T*"}}
    with pytest.raises(ValueError, match="column Tx is there 2 times.* by Tx.0, Tx.1"):
        read(tmp_path, lines, untold)


def test_counts_have_a_scale(tmp_path):
    columns = {
        "tension_*": {"unit": "counts", "scale": 0.0025},
        "a_*": {"unit": "mm", "scale": 0.1},
        "b_*": {"unit": "counts", "scale": 2e-5, "sign": -1},
    }
    positions = POSITION * np.array([1e4, -5e4])[:, None]
    assert_holds(read(tmp_path, plain(positions=positions, tension=TENSION / 0.0025), columns))


@pytest.mark.parametrize(
    ("columns", "error", "message"),
    [
        ({"tension_*": {"unit": "counts"}}, ValueError, "how many N a count is"),
        ({"a_x": {"unit": "counts"}}, ValueError, "how many m a count is"),
        ({"a_x": {"unit": "V"}}, ValueError, "should be one of m, cm, mm, counts"),
        ({"hold": {"scale": 2.0}}, ValueError, "columns.hold is text"),
        ({"a_x": {"scale": -1.0}}, ConfigurationError, "scale"),
    ],
)
def test_scales_and_units_that_say_nothing_are_told(tmp_path, columns, error, message):
    with pytest.raises(error, match=message):
        markers = {name: marker.model_dump() for name, marker in MARKERS.items()}
        parsed = MarkerSet.parse({"markers": markers, "columns": columns}, "test")
        read(tmp_path, plain(), parsed.columns)


def read_arrays(path, columns):
    markers = MarkerSet(markers=MARKERS, columns=columns)
    scene = load_scene("three_tendon")
    return read_recordings([path], scene, markers)


def test_arrays_of_numpy_are_columns(tmp_path):
    path = tmp_path / "log.npz"
    rate = np.float64(100.0)  # of no row: it is left out
    np.savez(
        path, hold=np.arange(3), tension=TENSION, a=POSITION[:, 0], b=POSITION[:, 1], rate=rate
    )
    recordings = read_arrays(path, {})
    assert_holds(recordings)
    assert [hold.name for hold in recordings] == ["0", "1", "2"]


def test_arrays_and_structures_of_matlab_are_columns(tmp_path):
    path = tmp_path / "log.mat"
    tension = np.vstack([TENSION, TENSION[0]]).T  # a row for each tendon
    places = np.concatenate([POSITION, POSITION[:1]])
    names = np.array(["h", "i", "j", "k"], dtype=object)
    savemat(path, {"rig": {"u": tension, "p": places}, "names": names})
    columns = {
        "hold": {"name": "names"},
        "tension_*": {"name": "rig.u_*"},
        "a_*": {"name": "rig.p_0_*"},
        "b_*": {"name": "rig.p_1_*"},
    }
    recordings = read_arrays(path, columns)
    assert_holds(recordings[:3])
    assert [hold.name for hold in recordings] == ["h", "i", "j", "k"]


@pytest.mark.parametrize(
    ("name", "content", "message"),
    [
        ("log.csv", b"PK\3\4secret", "is a ZIP archive, such as a spreadsheet"),
        ("log.c3d", b"\2\x50secret", "is a C3D file"),
        ("log.csv", b'{"secret": 1}', "is JSON"),
        ("log.csv", b"<secret>", "is XML or HTML"),
        ("log.csv", b"se\0cret,1\n2", "is of bytes that are no text"),
        ("log.npz", b"PKsecret", "cannot be read as .npz"),
        ("log.mat", b"secret", "cannot be read as .mat"),
        (
            "log.mat",
            b"MATLAB 7.3 MAT-file" + 493 * b" " + b"\x89HDF\r\n",
            "of version 7.3: save it",
        ),
        ("log.csv", b"secret " * 400, "is the file a table?"),
        ("log.csv", b"my secret text\n", "is the file a table?"),
        ("log.csv", b"my secret text\nin two lines\n", "is the file a table?"),
    ],
)
def test_a_file_that_is_no_table_is_told_by_its_kind_and_not_its_contents(
    tmp_path, name, content, message
):
    path = tmp_path / name
    path.write_bytes(content)
    with pytest.raises(ValueError, match=message) as raised:
        read_arrays(path, {})
    assert "secret" not in str(raised.value)
    assert "\n" not in str(raised.value)
    assert len(str(raised.value)) < 600
