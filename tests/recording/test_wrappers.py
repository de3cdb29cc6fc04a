"""Wrappers hand the right samples to the file, which only remembers them here, and episodes are
collected as they happened."""

import gymnasium as gym
import numpy as np
import pytest

from soft_tendon_env.recording import RecordRollout, VectorRecordRollout, collect, wrappers
from soft_tendon_env.registration import IDS

SMALL = {"scene": "three_tendon", "fidelity": "fast", "max_episode_steps": 5}
ACTION = np.array([0.5, -0.5, 0.0], dtype=np.float32)
STEPS = 6


class MemoryFile:
    path = "shared.rrd"

    def __init__(self):
        self.arms = []
        self.places = []
        self.written = []
        self.closed = False

    def add_arm(self, arm, model, place=None):
        self.arms.append(arm)
        self.places.append(place)

    def write(self, rollout, arm="arm", *, continues=False):
        assert not self.closed
        assert arm in self.arms
        self.written.append((arm, rollout, continues))

    def close(self):
        self.closed = True

    def samples(self, arm="arm"):
        """Numbers of the samples of each written rollout."""
        return [rollout.samples for name, rollout, _ in self.written if name == arm]


@pytest.fixture
def file(monkeypatch):
    remembering = MemoryFile()
    monkeypatch.setattr(wrappers, "_open", lambda path: remembering)
    return remembering


def make():
    return gym.make(IDS["TipPose"], **SMALL)


def rows_of(mode, rows=(0, 1)):
    return VectorRecordRollout(
        gym.make_vec(IDS["TipPose"], num_envs=2, autoreset_mode=mode, **SMALL),
        "unused.rrd",
        rows=rows,
    )


def play(env, episodes):
    """Tensions and errors of every sample."""
    seen = []
    for seed in range(episodes):
        info = env.reset(seed=seed)[1]
        truncated = False
        seen.append((env.unwrapped.episodes.tension[0].copy(), info["position_error"]))
        while not truncated:
            *_, truncated, info = env.step(ACTION)
            seen.append((env.unwrapped.episodes.tension[0].copy(), info["position_error"]))
    return seen


def test_every_episode_is_recorded_from_reset_to_end(file):
    env = RecordRollout(make(), "unused.rrd", flush_period=None)
    assert env.rollout is None
    seen = play(env, 2)
    assert file.samples() == [6, 6]
    assert env.rollout is file.written[-1][1]
    for episode, (arm, rollout, continues) in enumerate(file.written):
        tension, error = zip(*seen[6 * episode : 6 * episode + 6], strict=True)
        assert arm == "arm"
        assert not continues
        assert rollout.title == f"episode {episode}, target random, seed {episode}"
        np.testing.assert_array_equal(rollout.tension, tension)
        np.testing.assert_array_equal(rollout.scalars["position_error"], error)
        expected_action = [[np.nan] * 3] + [ACTION] * 5
        np.testing.assert_array_equal(rollout.action, expected_action)
        assert np.isnan(rollout.scalars["reward"][0])
        assert (rollout.scalars["reward"][1:] > 0.0).all()


def test_parts_are_written_during_the_episode(file):
    play(RecordRollout(make(), "unused.rrd", flush_period=0.0), 2)
    assert file.samples() == [2, 1, 1, 1, 1] * 2
    assert [continues for _, _, continues in file.written] == [False, True, True, True, True] * 2


def test_an_episode_cut_short_is_recorded_and_one_without_a_step_is_not(file):
    recorder = RecordRollout(make(), "unused.rrd")
    recorder.reset()
    recorder.reset()
    recorder.step(ACTION)
    recorder.reset()
    recorder.step(ACTION)
    recorder.step(ACTION)
    recorder.close()
    assert file.samples() == [2, 3]
    assert file.closed


@pytest.mark.parametrize(
    ("mode", "samples"),
    [("next_step", [6, 6, 2]), ("same_step", [5, 5, 4]), ("disabled", [6, 6, 3])],
)
def test_rows_are_recorded_in_every_mode(mode, samples, file):
    """The step of a reset belongs to no episode; what ends and is reset in one step lacks its last
    sample."""
    env = rows_of(mode)
    env.reset(seed=7)
    for step in range(13 if mode != "disabled" else 12):
        if mode == "disabled" and step in (5, 10):
            env.reset(options={"reset_mask": np.array([True, True])})
        env.step(np.stack([ACTION, -ACTION]))
    env.close()
    assert file.samples("row_0") == file.samples("row_1") == samples
    first = {arm: rollout for arm, rollout, _ in reversed(file.written)}
    assert [first[f"row_{row}"].title for row in range(2)] == [
        f"episode 0, target random, seed {7 + row}" for row in range(2)
    ]
    expected_action = np.tile(-ACTION, (samples[0] - 1, 1))
    np.testing.assert_array_equal(first["row_1"].action[1:], expected_action)


@pytest.fixture
def env():
    return gym.make("TendonRod-Shape-v0", fidelity="fast", max_episode_steps=STEPS)


def actions(seed=0):
    rng = np.random.default_rng(seed)
    return iter(rng.uniform(-1.0, 0.0, (100, 10)).astype(np.float32))


def test_an_episode_is_collected_as_it_happened(env):
    given = actions()
    rollout = collect(env, lambda observation: next(given), seed=3)
    assert rollout.samples == STEPS + 1
    assert rollout.title == "seed 3"
    again = env.unwrapped
    given = actions()
    _, info = env.reset(seed=3)
    for sample in range(STEPS + 1):
        if sample:
            _, reward, _, _, info = env.step(next(given))
            assert rollout.scalars["reward"][sample] == reward
        assert rollout.scalars["backbone_error"][sample] == info["backbone_error"]
        np.testing.assert_array_equal(rollout.strain[sample], again.state.strain)
        np.testing.assert_array_equal(
            rollout.tip_pose[sample], again.episodes.arms.reading.tip_pose[0]
        )
        np.testing.assert_array_equal(
            rollout.target_backbone[sample], again.episodes.target_backbone[0]
        )
        np.testing.assert_array_equal(rollout.tension[sample], again.episodes.tension[0])
