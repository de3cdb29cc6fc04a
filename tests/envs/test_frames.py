"""Frames of the environments: what Gymnasium's tools make of them."""

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.wrappers import RecordVideo

from soft_tendon_env.registration import IDS

SHAPE = (480, 640, 3)


@pytest.fixture
def env():
    return gym.make(IDS["Shape"], scene="three_tendon", render_mode="rgb_array", max_episode_steps=5)


@pytest.mark.filterwarnings("ignore:.*Overwriting existing videos.*")
def test_a_video_of_an_episode_is_recorded(env, tmp_path):
    video = RecordVideo(env, str(tmp_path), disable_logger=True)
    video.reset(seed=0)
    truncated = False
    while not truncated:
        _, _, _, truncated, _ = video.step(video.action_space.sample())
    video.close()
    (file,) = tmp_path.glob("*.mp4")
    assert file.stat().st_size > 5_000


def test_rows_have_a_frame_each(env):
    envs = gym.make_vec(IDS["Shape"], num_envs=2, scene="three_tendon", render_mode="rgb_array")
    envs.reset(seed=0)
    frames = envs.render()
    assert len(frames) == 2
    env.reset(seed=1)
    np.testing.assert_array_equal(frames[1], env.render())
