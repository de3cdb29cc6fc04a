"""Buffers of samples, and whole episodes as arrays, from the environments themselves: what is recorded is what happened."""

import dataclasses

import gymnasium as gym
import numpy as np
import pytest

from soft_tendon_env.recording import RecordRollout, VectorRecordRollout, collect, save_picture
from soft_tendon_env.recording.rollout import RolloutBuffer, scalar_columns

STEPS = 6
ARRAYS = ("strain", "tension", "tip_pose", "target_pose", "target_backbone", "action")


def refill(buffer, rollout, samples):
    for k in samples:
        strain, *arrays = (getattr(rollout, name)[k] for name in ARRAYS)
        buffer.append(rollout.model.grid.packed(strain), *arrays, {name: values[k] for name, values in rollout.scalars.items()})
    return buffer


def assert_equal(found, wanted, part=slice(None)):
    for name in ARRAYS:
        np.testing.assert_array_equal(getattr(found, name), getattr(wanted, name)[part])
    assert found.scalars.keys() == wanted.scalars.keys()
    for name, values in wanted.scalars.items():
        np.testing.assert_array_equal(found.scalars[name], values[part])


def test_a_buffer_returns_what_was_appended_and_starts_anew_when_cleared(rollout, model):
    """Arrays are copied: the environment writes over its own."""
    wanted = rollout(6)
    reused = dataclasses.replace(wanted, tension=wanted.tension.copy())
    filled = refill(RolloutBuffer(model, wanted.period), reused, range(3))
    assert len(filled) == 3
    first = filled.rollout()
    filled.clear()
    refill(filled, reused, range(3, 6))
    reused.tension[:] = 0.0
    assert_equal(first, wanted, slice(0, 3))
    assert_equal(filled.rollout(), wanted, slice(3, 6))


def test_scalars_are_numbers_and_bools_and_nan_where_missing():
    records = {"error": 1, "cause": "none"}, {"error": np.float32(0.5), "success": True}, {"success": np.False_, "array": [1.0]}
    columns = scalar_columns([*records])
    assert list(columns) == ["error", "success"]
    np.testing.assert_array_equal(columns["error"], [1.0, 0.5, np.nan])
    np.testing.assert_array_equal(columns["success"], [np.nan, 1.0, 0.0])


@pytest.mark.cases(
    "name, shape, wanted",
    [("strain", (7, 3), "(7, "), ("tension", (7, 2), "(7, 3)"), ("tip_pose", (6, 4, 4), "(7, 4, 4)"), ("action", (7,), "(7, any)")],
)
def test_a_rollout_names_the_array_of_wrong_shape(rollout, name, shape, wanted):
    with pytest.raises(ValueError, match=name) as raised:
        dataclasses.replace(rollout(7), **{name: np.zeros(shape)})
    assert wanted in str(raised.value) and str(shape) in str(raised.value)


def test_a_rollout_names_the_scalar_of_wrong_shape(rollout):
    with pytest.raises(ValueError, match="scalars\\['reward'\\]"):
        dataclasses.replace(rollout(7), scalars={"reward": np.zeros(6)})


@pytest.fixture
def env():
    return gym.make("TendonRod-Shape-v0", fidelity="fast", max_episode_steps=STEPS)


def actions(seed=0):
    return iter(np.random.default_rng(seed).uniform(-1.0, 0.0, (100, 10)).astype(np.float32))


def test_an_episode_is_collected_as_it_happened(env):
    given = actions()
    rollout = collect(env, lambda observation: next(given), seed=3)
    assert rollout.samples == STEPS + 1 and rollout.title == "seed 3"
    again, given = env.unwrapped, actions()
    _, info = env.reset(seed=3)
    for sample in range(STEPS + 1):
        if sample:
            _, reward, _, _, info = env.step(next(given))
            assert rollout.scalars["reward"][sample] == reward
        assert rollout.scalars["backbone_error"][sample] == info["backbone_error"]
        np.testing.assert_array_equal(rollout.strain[sample], again.state.strain)
        np.testing.assert_array_equal(rollout.tip_pose[sample], again.episodes.arms.reading.tip_pose[0])
        np.testing.assert_array_equal(rollout.target_backbone[sample], again.episodes.target_backbone[0])
        np.testing.assert_array_equal(rollout.tension[sample], again.episodes.tension[0])


def test_only_environments_of_the_package_are_collected():
    with pytest.raises(TypeError, match="soft_tendon_env"):
        collect(gym.make("CartPole-v1"), lambda observation: 0)


def test_a_picture_of_an_episode_is_written(env, tmp_path):
    given = actions()
    rollout = collect(env, lambda observation: next(given))
    save_picture(rollout, tmp_path / "episode.png", frames=2)
    assert (tmp_path / "episode.png").read_bytes().startswith(b"\x89PNG")
    save_picture(rollout, tmp_path / "episode.pdf", frames=1)
    assert (tmp_path / "episode.pdf").read_bytes().startswith(b"%PDF")


def test_the_real_environments_are_recorded(env, tmp_path):
    chunk = pytest.importorskip("rerun.chunk")
    recorder, given = RecordRollout(env, tmp_path / "one.rrd"), actions()
    for seed in (0, 1):
        recorder.reset(seed=seed)
        for _ in range(STEPS):
            recorder.step(next(given))
    recorder.close()
    for mode in ("next_step", "same_step"):
        envs = gym.make_vec("TendonRod-Shape-v0", num_envs=2, fidelity="fast", max_episode_steps=STEPS, autoreset_mode=mode)
        rows = VectorRecordRollout(envs, tmp_path / f"{mode}.rrd", rows=(0, 1))
        rows.reset(seed=0)
        for _ in range(2 * STEPS + (mode == "next_step")):
            rows.step(np.stack([next(given)] * 2))
        rows.close()
    for name, arms in (("one", ("arm",)), ("next_step", ("row_0", "row_1")), ("same_step", ("row_0", "row_1"))):
        found = [(c.entity_path, c.num_rows) for c in chunk.RrdReader(tmp_path / f"{name}.rrd").stream() if not c.is_static]
        for arm in arms:
            assert sum(count for entity, count in found if entity == f"/tension/{arm}") == 2 * (STEPS + 1), (name, arm)
