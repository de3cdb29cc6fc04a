"""Buffers of samples, and whole episodes as arrays, from the environments themselves: what is recorded is what happened."""

import gymnasium as gym
import numpy as np
import pytest

from soft_tendon_env.recording import RecordRollout, collect

STEPS = 6


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


def test_the_real_environments_are_recorded(env, tmp_path):
    chunk = pytest.importorskip("rerun.chunk")
    recorder, given = RecordRollout(env, tmp_path / "one.rrd"), actions()
    for seed in (0, 1):
        recorder.reset(seed=seed)
        for _ in range(STEPS):
            recorder.step(next(given))
    recorder.close()
    found = [(c.entity_path, c.num_rows) for c in chunk.RrdReader(tmp_path / "one.rrd").stream() if not c.is_static]
    assert sum(count for entity, count in found if entity == "/tension/arm") == 2 * (STEPS + 1)
