"""Recordings of real arms: what is read, and data that cannot be used, each in one line that says where."""

import numpy as np
import pytest

from soft_tendon_env.identification import load_markers
from soft_tendon_env.identification.recordings import Recording, read_recordings, same_commands, split
from soft_tendon_env.tools.configuration import ConfigurationError


@pytest.fixture
def changed(holds, tmp_path):
    """changed(line, column, text): the holds with another cell; line 1 is the header."""

    def write(line, column, text):
        rows = [row.split(",") for row in holds.read_text().splitlines()]
        rows[line - 1][column] = text
        path = tmp_path / "changed.csv"
        path.write_text("\n".join(",".join(row) for row in rows) + "\n")
        return path

    return write


def test_holds_are_read_in_the_scenes_frame(arm, holds, placed, tensions):
    found = read_recordings([holds], arm, placed)
    assert [recording.name for recording in found[:2]] == ["holds0", "holds1"] and not any(recording.period for recording in found)
    assert np.allclose([recording.command[0] for recording in found], tensions)
    assert all(np.linalg.norm(recording.positions[0], axis=1) @ [1, 0, 0] < 0.12 < recording.positions[0, 2, 0] for recording in found)


@pytest.mark.cases(
    "line, column, text, message",
    [
        (1, 3, "tension_0", "column tension_0 is there 2 times"),
        (4, 7, "lost", "line 4: middle_x is 'lost': it should be a finite number, or empty where there is none"),
        (5, 1, "306", "line 5: tension_0 is 306 N: the scene's tension_limits are 0 to 5 N; is it in mN or g? [columns] of the"),
        (3, 0, "holds0", "line 3: hold 'holds0' has a second row: samples of a motion need a column time"),
        (5, 0, "holds0", "hold 'holds0' is there 2 times"),
    ],
)
def test_bad_data_are_told_with_their_place(arm, changed, placed, line, column, text, message):
    with pytest.raises(ValueError) as raised:
        read_recordings([changed(line, column, text)], arm, placed)
    assert message in str(raised.value) and "\n" not in str(raised.value)


@pytest.mark.cases(
    "text, message",
    [
        ("[markers.a]\narc_length = 0.9", "markers.a.arc_length is 0.9: it should be at most the rod's length, 0.3 m"),
        ("[markers.a]\narc_length = 90", "markers.a.arc_length is 90: it should be at most the rod's length, 0.3 m; is it in mm?"),
        ("[markers.a]\narc_length = 0.1\noffset = [0, 0, 12]", "markers.a.offset is 12: it should be at most the rod's length"),
        ("[markers.a]\narc = 0.1", "markers.a.arc is an unknown key"),
        ("[markers.a]\narc_length = 0.1\n[columns.a_x]\nsign = 2", "columns.a_x.sign is 2: it should be 1 or -1"),
        ("[markers.a]\narc_length = 0.1\n[frame]\nquaternion = [1, 1, 0, 0]", "should have length 1, not 1.414"),
    ],
)
def test_bad_markers_are_told(arm, tmp_path, text, message):
    path = tmp_path / "markers.toml"
    path.write_text(text)
    with pytest.raises(ConfigurationError) as raised:
        load_markers(path, arm)
    assert message in str(raised.value) and str(path) in str(raised.value)


def test_a_share_or_a_column_is_held_out(arm, holds, placed):
    found = read_recordings([holds], arm, placed)
    assert [len(part) for part in split(found)] == [12, 4] and [len(part) for part in split(found, "0")] == [16, 0]
    assert len(split(found, "tension_0")[1]) == 10


@pytest.mark.cases("held_out, message", [("-1", "a share from 0"), ("weight", "no column of that name with numbers"), ("1.5", "a share")])
def test_bad_shares_are_told(arm, holds, placed, held_out, message):
    with pytest.raises(ValueError, match="held_out is") as raised:
        split(read_recordings([holds], arm, placed), held_out)
    assert message in str(raised.value)


def recordings_of(*commands, period=0.0):
    """Recordings of commands, a motion for each list of them."""
    return [Recording(f"{i}", "simulated", np.atleast_2d(command), np.full((1, 1, 3), i), period, {}) for i, command in enumerate(commands)]


@pytest.mark.cases(
    "commands, groups",
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


@pytest.mark.cases("share, count", [("0.25", 4), ("0.5", 8)])
def test_repeats_stay_together_when_some_are_held_out(share, count):
    tensions = np.random.default_rng(0).uniform(0.0, 5.0, (4, 3))
    parts = split(recordings_of(*(np.tile(tensions, (4, 1)) + 0.01 * np.random.default_rng(1).uniform(size=(16, 3)))), share)
    seen, unseen = ({int(one.name) % 4 for one in part} for part in parts)
    assert len(parts[1]) == count and not seen & unseen


def test_displacements_beyond_their_limits_are_told(arm, holds, placed, tmp_path):
    path = tmp_path / "pulled.csv"
    path.write_text(holds.read_text().replace("tension_", "displacement_"))
    driven = arm.replace({"effects.tendon_elasticity": {"stiffness": 3e3, "displacement_limits": [-0.01, 0.03]}})
    with pytest.raises(ValueError, match="m: the scene's displacement_limits are -0.01 to 0.03 m; is it in cm or mm. .columns."):
        read_recordings([path], driven, placed)
