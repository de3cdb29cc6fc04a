"""The wrappers hand the right samples to the file; the files of these tests only remember what they were given."""

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.vector import AutoresetMode

from soft_tendon_env.recording import RecordRollout, VectorRecordRollout, wrappers
from soft_tendon_env.recording.wrappers import row_info

ACTION = np.array([0.5, -0.5])
ACTIONS = np.array([[0.5, -0.5], [0.25, -0.25]])


class MemoryFile:
    def __init__(self, path):
        self.path, self.arms, self.places, self.written, self.closed = path, [], [], [], False

    def add_arm(self, arm, model, place=None):
        self.arms.append(arm)
        self.places.append(place)

    def write(self, rollout, arm="arm", *, continues=False):
        assert not self.closed and arm in self.arms
        self.written.append((arm, rollout, continues))

    def close(self):
        self.closed = True

    def steps(self, arm="arm"):
        """Numbers of the steps of each written rollout."""
        return [rollout.tension[:, 0].tolist() for name, rollout, _ in self.written if name == arm]


@pytest.fixture
def file(monkeypatch):
    remembering = MemoryFile("unused.rrd")
    monkeypatch.setattr(wrappers, "_open", lambda path: remembering)
    return remembering


def play(env, episodes):
    for seed in range(episodes):
        env.reset(seed=seed)
        while not env.step(ACTION)[3]:
            pass


def test_every_episode_is_recorded_from_reset_to_end(env, file, bent):
    play(RecordRollout(env, "unused.rrd"), 2)
    assert file.steps() == [[0, 1, 2, 3, 4, 5]] * 2
    for episode, (arm, rollout, continues) in enumerate(file.written):
        assert arm == "arm" and not continues
        assert rollout.title == f"episode {episode}, target random, seed {episode}"
        np.testing.assert_array_equal(rollout.tension[:, 1], episode)
        np.testing.assert_array_equal(rollout.strain, bent(0.1 * np.arange(6)))
        np.testing.assert_array_equal(rollout.action, [[np.nan] * 2] + [ACTION] * 5)
        assert rollout.scalars.keys() == {"position_error", "diverged", "reward"}
        np.testing.assert_array_equal(rollout.scalars["position_error"], np.arange(6))
        np.testing.assert_array_equal(rollout.scalars["reward"], [np.nan, 1, 2, 3, 4, 5])


def test_a_trigger_selects_episodes(env, file):
    play(RecordRollout(env, "unused.rrd", episode_trigger=lambda number: number % 2 == 1), 4)
    assert [rollout.title for _, rollout, _ in file.written] == ["episode 1, target random, seed 1", "episode 3, target random, seed 3"]


def test_parts_are_written_during_the_episode(env, file):
    recorder = RecordRollout(env, "unused.rrd", flush_period=0.0)
    play(recorder, 2)
    assert file.steps() == [[0, 1], [2], [3], [4], [5]] * 2
    assert [continues for _, _, continues in file.written] == [False, True, True, True, True] * 2


def test_an_episode_cut_short_is_recorded_and_one_without_a_step_is_not(env, file):
    recorder = RecordRollout(env, "unused.rrd")
    recorder.reset()
    recorder.reset()
    recorder.step(ACTION)
    recorder.reset()
    recorder.step(ACTION)
    recorder.step(ACTION)
    recorder.close()
    recorder.close()
    assert file.steps() == [[0, 1], [0, 1, 2]] and file.closed


def test_a_file_given_open_is_shared_and_left_open(build_env):
    file = MemoryFile("shared.rrd")
    recorders = [RecordRollout(build_env(), file, name=name, place=(0.0, y, 0.0)) for name, y in (("left", 0.0), ("right", 1.5))]
    again = RecordRollout(build_env(), file, name="right", place=None)  # an arm that is there
    for recorder in (*recorders, again):
        play(recorder, 1)
        recorder.close()
    assert file.arms == ["left", "right"] and file.places == [(0.0, 0.0, 0.0), (0.0, 1.5, 0.0)]
    assert [arm for arm, _, _ in file.written] == ["left", "right", "right"]
    assert not file.closed


def test_other_environments_are_refused(file):
    with pytest.raises(TypeError, match="soft_tendon_env"):
        RecordRollout(gym.make("CartPole-v1"), "unused.rrd")


def play_rows(env, steps, **kwargs):
    env.reset(**kwargs)
    for _ in range(steps):
        env.step(ACTIONS)
    env.close()


def test_the_step_of_a_reset_belongs_to_no_episode(vector_env, file):
    play_rows(VectorRecordRollout(vector_env(AutoresetMode.NEXT_STEP), "unused.rrd", rows=(0, 1)), 13)
    assert file.steps("row_0") == [[0, 1, 2, 3, 4, 5], [0, 1, 2, 3, 4, 5], [0, 1]]
    assert file.steps("row_1") == [[0, 1, 2, 3, 4, 5, 6]] * 2
    for arm, rollout, _ in file.written:
        np.testing.assert_array_equal(rollout.tension[:, 2], int(arm[-1]))
        np.testing.assert_array_equal(rollout.scalars["reward"][1:], rollout.tension[1:, 0])
        np.testing.assert_array_equal(rollout.action[1:], np.tile(ACTIONS[int(arm[-1])], (len(rollout.action) - 1, 1)))


def test_reset_in_the_same_step_keeps_the_last_sample(vector_env, file):
    play_rows(VectorRecordRollout(vector_env(AutoresetMode.SAME_STEP), "unused.rrd", rows=(0, 1)), 7)
    assert file.steps("row_0") == [[0, 1, 2, 3, 4, 5], [0, 1, 2]]
    assert file.steps("row_1") == [[0, 1, 2, 3, 4, 5, 6], [0, 1]]
    for _, rollout, _ in file.written:
        np.testing.assert_array_equal(rollout.scalars["reward"][1:], rollout.tension[1:, 0])
        np.testing.assert_array_equal(rollout.scalars["position_error"], rollout.tension[:, 0])


def test_reset_in_the_same_step_without_a_last_sample_omits_it(vector_env, file):
    play_rows(VectorRecordRollout(vector_env(AutoresetMode.SAME_STEP, keeps_last=False), "unused.rrd"), 7)
    assert file.steps("row_0") == [[0, 1, 2, 3, 4], [0, 1, 2]]


def test_without_autoreset_the_rows_named_are_reset(vector_env, file):
    env = VectorRecordRollout(vector_env(AutoresetMode.DISABLED), "unused.rrd", rows=(0, 1))
    env.reset()
    for _ in range(5):
        env.step(ACTIONS)
    env.reset(options={"reset_mask": np.array([True, False])})
    env.step(ACTIONS)
    env.close()
    assert file.steps("row_0") == [[0, 1, 2, 3, 4, 5], [0, 1]]
    assert file.steps("row_1") == [[0, 1, 2, 3, 4, 5, 6]]


@pytest.mark.parametrize(("seed", "titles"), [(7, [7, 8]), ([3, None], [3, None]), (None, [None, None])])
def test_rows_are_titled_with_their_seeds(vector_env, file, seed, titles):
    play_rows(VectorRecordRollout(vector_env(AutoresetMode.NEXT_STEP), "unused.rrd", rows=(0, 1)), 2, seed=seed)
    found = {arm: rollout.title for arm, rollout, _ in file.written}
    begin = "episode 0, target random"
    expected = {f"row_{row}": begin if s is None else f"{begin}, seed {s}" for row, s in enumerate(titles)}
    assert found == expected


def test_rows_that_there_are_not_are_refused(vector_env, file):
    with pytest.raises(ValueError, match="rows should be from 0 to 1, not \\[2\\]"):
        VectorRecordRollout(vector_env(AutoresetMode.NEXT_STEP), "unused.rrd", rows=(0, 2))


def test_masks_say_which_infos_a_row_has():
    infos = {"a": np.array([1.0, 2.0]), "_a": np.array([True, False]), "b": np.array([3, 4]), "episode": {"r": np.zeros(2)}, "note": "text"}
    assert row_info(infos, 0) == {"a": 1.0, "b": 3}
    assert row_info(infos, 1) == {"b": 4}
