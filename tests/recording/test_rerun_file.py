"""What is written to a file is read back with Rerun's own reader."""

import dataclasses
import signal
import subprocess
import sys
from collections import defaultdict

import numpy as np
import pytest

from soft_tendon_env.drawing.geometry import tension_colors
from soft_tendon_env.drawing.shapes import backbones, tendon_curves

pytest.importorskip("rerun")
from rerun.chunk import RrdReader  # noqa: E402

from soft_tendon_env.recording.rerun_file import RerunFile  # noqa: E402
from soft_tendon_env.recording.rollout import Rollout  # noqa: E402

FLOAT32 = {"rtol": 1e-6, "atol": 1e-7}

KILLED = """
import os, signal, sys
import numpy as np
from soft_tendon_env.model.build import build_model
from soft_tendon_env.recording import RerunFile, Rollout
from soft_tendon_env.scene.file import load_scene

model = build_model(load_scene("three_tendon"))
strain = np.tile(model.grid.unpacked(model.arm.rod.reference_strain), (10, 1, 1))
file = RerunFile(sys.argv[1])
for part in range(3):
    tension = np.arange(30.0).reshape(10, 3) + 30 * part
    file.write(Rollout(model, 0.02, strain, tension, np.tile(np.eye(4), (10, 1, 1))), continues=part > 0)
os.kill(os.getpid(), signal.SIGKILL)
"""


class Read(dict):
    """A file's rows: [entity, column] -> list of what each row holds; times[entity, timeline] -> list; both in the order of writing."""

    def __init__(self, path):
        self.times = defaultdict(list)
        columns = defaultdict(list)
        for chunk in RrdReader(path).stream():
            batch = chunk.to_record_batch()
            for name in batch.schema.names:
                if name in chunk.timeline_names:
                    self.times[chunk.entity_path, name] += batch[name].cast("int64").to_pylist()
                else:
                    columns[chunk.entity_path, name] += [row for row in batch[name].to_pylist() if row is not None]
        super().__init__(columns)

    def written(self):
        """All but what differs from file to file: identifiers, the name and the time of the start."""
        return {key: rows for key, rows in self.items() if key[0] != "/__properties" and not key[1].startswith("rerun.")}

    def array(self, entity, column):
        return np.array(self[entity, column])


@pytest.fixture
def path(tmp_path):
    return tmp_path / "new folder" / "recording.rrd"


def verify(path):
    return subprocess.run([sys.executable, "-m", "rerun", "rrd", "verify", str(path)], capture_output=True, text=True)


def test_an_episode_is_read_back_as_written(path, rollout):
    wanted = rollout(7)
    with RerunFile(path) as file:
        file.write(wanted)
    read = Read(path)
    np.testing.assert_array_equal(read.array("/tension/arm", "Scalars:scalars"), wanted.tension)
    np.testing.assert_array_equal(read.array("/action/arm", "Scalars:scalars"), wanted.action)
    for entity, name in (("error", "position_error"), ("reward", "reward"), ("other", "substeps")):
        np.testing.assert_array_equal(read.array(f"/{entity}/arm/{name}", "Scalars:scalars")[:, 0], wanted.scalars[name])
    for entity, pose in (("tip", wanted.tip_pose), ("target", wanted.target_pose)):
        np.testing.assert_allclose(read.array(f"/world/arm/{entity}", "Transform3D:translation")[:, 0], pose[:, :3, 3], **FLOAT32)
        by_columns = read.array(f"/world/arm/{entity}", "Transform3D:mat3x3").reshape(-1, 3, 3)
        np.testing.assert_allclose(by_columns.swapaxes(1, 2), pose[:, :3, :3], **FLOAT32)
    np.testing.assert_allclose(read.array("/plot/position_error/arm", "Scalars:scalars")[:, 0], 1e3 * wanted.scalars["position_error"])
    logarithms = read.array("/log10_plot/position_error/arm", "Scalars:scalars")[:, 0]
    np.testing.assert_allclose(10.0**logarithms, 1e3 * wanted.scalars["position_error"], rtol=1e-12)
    assert read["/episodes/arm", "TextLog:text"] == [["episode 0"]]
    for entity in ("/tension/arm", "/world/arm/tip", "/world/arm/tendons", "/reward/arm/reward"):
        assert read.times[entity, "sim_time"] == [20_000_000 * k for k in range(7)]
        assert read.times[entity, "step"] == list(range(7))
        assert read.times[entity, "episode"] == [0] * 7


def test_curves_are_those_of_the_arm(path, rollout):
    wanted = rollout(7)
    with RerunFile(path, stations=9) as file:
        file.write(wanted)
    read = Read(path)
    backbone = read.array("/world/arm/backbone", "LineStrips3D:strips")[:, 0]
    station = np.linspace(0.0, wanted.model.grid.breakpoints[-1], 9)
    np.testing.assert_allclose(backbone, backbones(wanted.model, wanted.strain, station)[..., :3, 3], **FLOAT32)
    np.testing.assert_allclose(backbone[:, -1], wanted.tip_pose[:, :3, 3], **FLOAT32)
    target = read.array("/world/arm/target_backbone", "LineStrips3D:strips")[:, 0]
    np.testing.assert_allclose(target, wanted.target_backbone, **FLOAT32)
    tendons = tendon_curves(wanted.model, backbones(wanted.model, wanted.strain, station), station)
    for sample, strips in enumerate(read["/world/arm/tendons", "LineStrips3D:strips"]):
        for strip, curve in zip(strips, tendons, strict=True):
            np.testing.assert_allclose(strip, curve[sample], **FLOAT32)
    colors = read.array("/world/arm/tendons", "LineStrips3D:colors")
    np.testing.assert_array_equal(colors, tension_colors(wanted.model, wanted.tension))
    centers = read.array("/world/arm/body", "Cylinders3D:centers")
    np.testing.assert_allclose(centers, 0.5 * (backbone[:, 1:] + backbone[:, :-1]), **FLOAT32)


def test_an_episode_in_parts_is_the_episode(path, rollout, tmp_path):
    whole = rollout(7)
    with RerunFile(path) as file:
        file.write(whole)
    other = tmp_path / "parts.rrd"
    with RerunFile(other) as file:
        for first, last in ((0, 3), (3, 4), (4, 7)):
            arrays = ("strain", "tension", "tip_pose", "target_pose", "target_backbone", "action")
            part = {name: getattr(whole, name)[first:last] for name in arrays}
            scalars = {name: values[first:last] for name, values in whole.scalars.items()}
            file.write(dataclasses.replace(whole, scalars=scalars, **part), continues=first > 0)
    expected, found = Read(path), Read(other)
    assert found.times == expected.times
    assert found.written() == expected.written()


def test_trails_join_the_places_of_one_episode_and_no_others(path, rollout):
    wanted = rollout(4)
    moving = wanted.target_pose.copy()
    moving[:, 0, 3] += np.arange(4)
    wanted = dataclasses.replace(wanted, target_pose=moving)
    with RerunFile(path) as file:
        file.write(wanted)
        file.write(wanted)
    read = Read(path)
    for entity, pose in (("trail", wanted.tip_pose), ("target_trail", wanted.target_pose)):
        trail, place = read.array(f"/world/arm/{entity}", "LineStrips3D:strips")[:, 0], pose[:, :3, 3]
        np.testing.assert_allclose(trail[:, 1], np.tile(place, (2, 1)), **FLOAT32)
        np.testing.assert_allclose(trail[:, 0], np.tile(np.concatenate([place[:1], place[:-1]]), (2, 1)), **FLOAT32)


def test_episodes_of_an_arm_follow_one_another_and_arms_run_side_by_side(path, rollout):
    with RerunFile(path) as file:
        file.add_arm("nominal", rollout().model)
        file.add_arm("other/arm", rollout().model, place=(0.0, 1.5, 0.0))
        file.write(rollout(4, seed=1), "nominal")
        file.write(rollout(3, seed=2), "other/arm")
        file.align()
        file.write(rollout(2, seed=3), "nominal")
        file.write(rollout(2, seed=4), "other/arm")
    read = Read(path)
    other = r"other\/arm"
    assert read.times["/tension/nominal", "step"] == [0, 1, 2, 3, 4, 5]
    assert read.times["/tension/nominal", "episode"] == [0, 0, 0, 0, 1, 1]
    assert read.times[f"/tension/{other}", "step"] == [0, 1, 2, 4, 5]
    assert read.times[f"/tension/{other}", "sim_time"] == [20_000_000 * k for k in (0, 1, 2, 4, 5)]
    np.testing.assert_array_equal(read.array("/tension/nominal", "Scalars:scalars")[4:], rollout(2, seed=3).tension)
    np.testing.assert_allclose(read.array(f"/world/{other}", "Transform3D:translation"), [[[0.0, 1.5, 0.0]]])


def test_errors_from_a_micrometre_to_a_metre_are_decades_apart(path, rollout):
    """In millimetres and degrees; an error of zero has no logarithm and lies at the bottom."""
    given = np.array([3e-5, 0.3, np.nan, 0.0])
    scalars = {"position_error": given, "angle_error": given, "coordinate_error": given}
    with RerunFile(path) as file:
        file.write(dataclasses.replace(rollout(4), scalars=scalars))
    read = Read(path)
    for name, factor in (("position_error", 1e3), ("angle_error", 180.0 / np.pi), ("coordinate_error", 1.0)):
        found = read.array(f"/log10_plot/{name}/arm", "Scalars:scalars")[:, 0]
        np.testing.assert_allclose(found, [*np.log10(factor * given[:2]), np.nan, -6.0], rtol=1e-12)


def test_a_killed_process_leaves_what_was_written(path):
    done = subprocess.run([sys.executable, "-c", KILLED, str(path)], capture_output=True, text=True)
    assert done.returncode == -signal.SIGKILL, done.stderr
    with pytest.warns(Warning, match="no footer"):
        read = Read(path)
    np.testing.assert_array_equal(read.array("/tension/arm", "Scalars:scalars"), np.arange(90.0).reshape(30, 3))
    assert read.times["/world/arm/tip", "step"] == list(range(30))


def test_another_scene_needs_another_name(path, rollout, build):
    first = rollout()
    with RerunFile(path) as file:
        file.write(first)
        softer = build("three_tendon", {"segments.0.density": 1234.0})
        with pytest.raises(ValueError, match="'arm' has another scene"):
            file.write(dataclasses.replace(first, model=softer))
        file.write(dataclasses.replace(first, model=softer), "softer")
        with pytest.raises(ValueError, match="'softer' is in .* already"):
            file.add_arm("softer", softer)


def test_a_closed_file_passes_the_check_of_rerun_and_takes_nothing(path, rollout):
    file = RerunFile(path)
    file.write(rollout())
    file.write(dataclasses.replace(rollout(), target_pose=None, target_backbone=None, action=None, scalars={}))
    file.close()
    file.close()
    done = verify(path)
    assert done.returncode == 0, done.stderr
    with pytest.raises(ValueError, match="is closed"):
        file.write(rollout())


def test_a_file_that_cannot_be_written_is_said_to_be_so(tmp_path):
    with pytest.raises(OSError):
        RerunFile(tmp_path)


BALL = {"type": "sphere", "position": [0.2, 0.1, 0.0], "radius": 0.03}


def test_a_recording_shows_a_moving_base_and_the_obstacles_of_each_episode(path, build):
    """The mount and the arm go along; obstacles are sent anew where an episode has others, at their sizes."""
    changes = {"effects.contact.obstacles": [BALL], "effects.moving_base.velocity": [0.0, 0.5, 0.0]}
    model = build("three_tendon", {"quadrature.intervals": 4, **changes})
    strain = np.tile(model.grid.unpacked(model.arm.rod.reference_strain), (3, 1, 1))
    larger = model.scene.replace({"effects.contact.obstacles.0.radius": 0.05}).effects
    tip = np.tile(np.eye(4), (3, 1, 1))
    with RerunFile(path) as file:
        for effects in (None, None, larger):
            file.write(Rollout(model, 0.1, strain, np.zeros((3, 3)), tip, effects=effects))
    read, moved = Read(path), np.tile([[0.0, 0.0, 0.0], [0.0, 0.05, 0.0], [0.0, 0.1, 0.0]], (3, 1))
    np.testing.assert_allclose(np.squeeze(read.array("/world/arm/mount", "Transform3D:translation")), moved, atol=1e-6)
    first = np.array([lines[0][0] for lines in read["/world/arm/backbone", "LineStrips3D:strips"]])
    np.testing.assert_allclose(first, moved, atol=1e-6)
    meshes = read["/world/arm/solids/0", "Mesh3D:vertex_positions"]
    radii = [np.linalg.norm(np.array(mesh) - BALL["position"], axis=1).max() for mesh in meshes]
    np.testing.assert_allclose(radii, [0.03, 0.05], atol=1e-6)
    assert read.times["/world/arm/solids/0", "step"][-1] == 6
    assert verify(path).returncode == 0
