"""What is written to a file is read back with Rerun's own reader; the viewer opens with every
quantity in a plot of its own."""

import dataclasses
import subprocess
import sys
from collections import defaultdict

import numpy as np
import pytest

pytest.importorskip("rerun")
import rerun.blueprint as rrb  # noqa: E402
from rerun.chunk import RrdReader  # noqa: E402

from soft_tendon_env.drawing.palette import styles  # noqa: E402
from soft_tendon_env.drawing.shapes import side_by_side  # noqa: E402
from soft_tendon_env.recording.rerun_file import RerunFile  # noqa: E402
from soft_tendon_env.recording.rerun_layout import DrawnArm, layout  # noqa: E402
from soft_tendon_env.recording.rollout import Rollout  # noqa: E402

FLOAT32 = {"rtol": 1e-6, "atol": 1e-7}
BALL = {"type": "sphere", "position": [0.2, 0.1, 0.0], "radius": 0.03}
SERIES = {
    "tension": ["tension 0", "tension 1", "tension 2"],
    "action": ["action 0", "action 1", "action 2"],
    "error": ["position_error", "angle_error"],
    "reward": ["reward", "reward_position"],
    "other": ["diverged"],
}


class Read(dict):
    """A file's rows: [entity, column] -> list of what each row holds; times[entity, timeline] ->
    list; both in the order of writing."""

    def __init__(self, path):
        self.times = defaultdict(list)
        columns = defaultdict(list)
        for chunk in RrdReader(path).stream():
            batch = chunk.to_record_batch()
            for name in batch.schema.names:
                if name in chunk.timeline_names:
                    self.times[chunk.entity_path, name] += batch[name].cast("int64").to_pylist()
                else:
                    columns[chunk.entity_path, name] += [
                        row for row in batch[name].to_pylist() if row is not None
                    ]
        super().__init__(columns)

    def written(self):
        """All but what differs from file to file: identifiers, the name and the time of the
        start."""
        return {
            key: rows
            for key, rows in self.items()
            if key[0] != "/__properties" and not key[1].startswith("rerun.")
        }

    def array(self, entity, column):
        return np.array(self[entity, column])


@pytest.fixture
def path(tmp_path):
    return tmp_path / "new folder" / "recording.rrd"


def test_spacer_discs_are_where_the_rod_is(path, rollout):
    wanted = rollout(3)
    discs = {"segments.0.discs": {"mass": 1e-3, "radius": 0.05, "number": 2}}
    with RerunFile(path) as file:
        file.write(
            dataclasses.replace(
                wanted, model=wanted.model.with_scene(wanted.model.scene.replace(discs))
            )
        )
    centers = Read(path).array("/world/arm/discs", "Cylinders3D:centers")
    length = wanted.model.scene.segments[0].length
    exact = [
        wanted.model.backbone_at(np.zeros(wanted.model.coordinate_count), [length / 2, length])[
            :, :3, 3
        ]
    ]
    np.testing.assert_allclose(centers[:1], exact, **FLOAT32)


def test_an_episode_is_read_back_as_written(path, rollout):
    wanted = rollout(7)
    with RerunFile(path) as file:
        file.write(wanted)
    read = Read(path)
    np.testing.assert_array_equal(read.array("/tension/arm", "Scalars:scalars"), wanted.tension)
    np.testing.assert_array_equal(read.array("/action/arm", "Scalars:scalars"), wanted.action)
    for entity, name in (("error", "position_error"), ("reward", "reward"), ("other", "substeps")):
        np.testing.assert_array_equal(
            read.array(f"/{entity}/arm/{name}", "Scalars:scalars")[:, 0], wanted.scalars[name]
        )
    for entity, pose in (("tip", wanted.tip_pose), ("target", wanted.target_pose)):
        np.testing.assert_allclose(
            read.array(f"/world/arm/{entity}", "Transform3D:translation")[:, 0],
            pose[:, :3, 3],
            **FLOAT32,
        )
        by_columns = read.array(f"/world/arm/{entity}", "Transform3D:mat3x3").reshape(-1, 3, 3)
        np.testing.assert_allclose(by_columns.swapaxes(1, 2), pose[:, :3, :3], **FLOAT32)
    np.testing.assert_allclose(
        read.array("/plot/position_error/arm", "Scalars:scalars")[:, 0],
        1e3 * wanted.scalars["position_error"],
    )
    assert read["/episodes/arm", "TextLog:text"] == [["episode 0"]]
    for entity in ("/tension/arm", "/world/arm/tip", "/world/arm/tendons", "/reward/arm/reward"):
        assert read.times[entity, "sim_time"] == [20_000_000 * k for k in range(7)]
        assert read.times[entity, "step"] == list(range(7))
        assert read.times[entity, "episode"] == [0] * 7


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
    expected = Read(path)
    found = Read(other)
    assert found.times == expected.times
    assert found.written() == expected.written()


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
    np.testing.assert_array_equal(
        read.array("/tension/nominal", "Scalars:scalars")[4:], rollout(2, seed=3).tension
    )
    np.testing.assert_allclose(
        read.array(f"/world/{other}", "Transform3D:translation"), [[[0.0, 1.5, 0.0]]]
    )


@pytest.mark.slow
def test_a_closed_file_passes_the_check_of_rerun_and_takes_nothing(path, rollout):
    file = RerunFile(path)
    file.write(rollout())
    file.write(
        dataclasses.replace(
            rollout(), target_pose=None, target_backbone=None, action=None, scalars={}
        )
    )
    file.close()
    file.close()
    done = subprocess.run(
        [sys.executable, "-m", "rerun", "rrd", "verify", str(path)], capture_output=True, text=True
    )
    assert done.returncode == 0, done.stderr
    with pytest.raises(ValueError, match="is closed"):
        file.write(rollout())


def test_a_recording_shows_a_moving_base_and_the_obstacles_of_each_episode(path, build):
    """The mount and the arm go along; obstacles are sent anew where an episode has others, at their
    sizes."""
    changes = {"effects.contact.obstacles": [BALL], "effects.moving_base.velocity": [0.0, 0.5, 0.0]}
    model = build("three_tendon", {"quadrature.intervals": 4, **changes})
    strain = np.tile(model.grid.unpacked(model.arm.rod.reference_strain), (3, 1, 1))
    larger = model.scene.replace({"effects.contact.obstacles.0.radius": 0.05})
    tip = np.tile(np.eye(4), (3, 1, 1))
    with RerunFile(path) as file:
        for scene in (None, None, larger):
            file.write(Rollout(model, 0.1, strain, np.zeros((3, 3)), tip, scene=scene))
    read = Read(path)
    moved = np.tile([[0.0, 0.0, 0.0], [0.0, 0.05, 0.0], [0.0, 0.1, 0.0]], (3, 1))
    np.testing.assert_allclose(
        np.squeeze(read.array("/world/arm/mount", "Transform3D:translation")), moved, atol=1e-6
    )
    first = np.array([lines[0][0] for lines in read["/world/arm/backbone", "LineStrips3D:strips"]])
    np.testing.assert_allclose(first, moved, atol=1e-6)
    meshes = read["/world/arm/solids/0", "Mesh3D:vertex_positions"]
    radii = [np.linalg.norm(np.array(mesh) - BALL["position"], axis=1).max() for mesh in meshes]
    np.testing.assert_allclose(radii, [0.03, 0.05], atol=1e-6)
    assert read.times["/world/arm/solids/0", "step"][-1] == 6


def arms_of(model, number):
    """Arms of one second each, side by side."""
    drawn = styles(f"arm {k}" for k in range(number))
    return {
        name: DrawnArm(
            model,
            style,
            np.array(side_by_side(model, k)),
            np.zeros(2),
            time=10**9,
            series=dict(SERIES),
        )
        for k, (name, style) in enumerate(drawn.items())
    }


def views(part):
    if isinstance(part, rrb.Blueprint):
        part = part.root_container
    if isinstance(part, rrb.View):
        return [part]
    return [view for child in part.contents for view in views(child)]


@pytest.mark.parametrize("number", [1, 4])
def test_every_error_has_a_plot_with_all_arms_and_every_arm_one_of_tensions_in_one_range(
    model, number
):
    plots = [
        view
        for view in views(layout(arms_of(model, number), 3.0, live=False))
        if view.class_identifier == "TimeSeries"
    ]
    found = {view.name if view.origin == "/" else view.origin: view for view in plots}
    assert {f"/plot/{error}": found[f"/plot/{error}"].name for error in SERIES["error"]} == {
        "/plot/position_error": f"position [mm], up to {20.0 * model.length:.3g}",
        "/plot/angle_error": "angle [deg], up to 10",
    }
    ranges = [
        found[f"/plot/{error}"].properties["ScalarAxis"].range.as_arrow_array().to_pylist()[0]
        for error in SERIES["error"]
    ]
    assert np.allclose(ranges, [[0.0, 20.0 * model.length], [0.0, 10.0]])
    for kind in ("tension", "action"):
        assert [origin for origin in found if origin.startswith(f"/{kind}/")] == [
            rf"/{kind}/arm\ {k}" for k in range(number)
        ]
    assert not [origin for origin in found if origin.startswith("/error")], (
        "metres and radians share no axis"
    )
    axes = [found[rf"/tension/arm\ {k}"].properties["ScalarAxis"] for k in range(number)]
    limits = np.array([tendon.tension_limits for tendon in model.scene.tendons])
    assert {tuple(axis.range.as_arrow_array().to_pylist()[0]) for axis in axes} == {
        (limits.min(), limits.max())
    }
