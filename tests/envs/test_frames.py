"""Pictures of rows: where tips have been in the episode, and targets that the task has."""

import gymnasium as gym
import numpy as np
import pytest

from soft_tendon_env.envs import IDS, frames


class Seen:
    """A renderer whose frames are the pictures themselves."""

    def __init__(self, model):
        self.model = model

    def frame(self, picture):
        return picture


@pytest.fixture(autouse=True)
def seen(monkeypatch):
    monkeypatch.setattr(frames, "ArmRenderer", Seen)


def drawn(task):
    """A row of a task at its beginning, with what draws it."""
    env = gym.make(IDS[task], scene="three_tendon", fidelity="fast", action="tension")
    env.reset(seed=0)
    episodes = env.unwrapped.episodes
    renderer = frames.RowRenderer(episodes)
    renderer.begin([0])
    return env, episodes, renderer


def test_trails_have_the_tip_of_every_step_of_the_episode():
    env, episodes, renderer = drawn("TipPose")
    tips = [episodes.arms.reading.tip_pose[0, :3, 3].copy()]
    for action in np.eye(3):
        env.step(action)
        renderer.step([0])
        tips.append(episodes.arms.reading.tip_pose[0, :3, 3].copy())
    (picture,) = renderer.frames()
    np.testing.assert_array_equal(picture.trail, tips)
    assert picture.title.startswith("t = 0.06 s")
    # another episode begins where the arm is
    renderer.begin([0])
    (picture,) = renderer.frames()
    np.testing.assert_array_equal(picture.trail, tips[-1:])


@pytest.mark.parametrize(
    ("task", "has_backbone", "has_axes"),
    [
        ("TipPose", False, True),
        ("Shape", True, True),
        ("Reach", False, False),
    ],
)
def test_targets_are_those_that_the_task_tells(task, has_backbone, has_axes):
    """Shapes have a backbone, and positions no axes."""
    _, episodes, renderer = drawn(task)
    (picture,) = renderer.frames()
    np.testing.assert_array_equal(picture.target_pose, episodes.target_pose[0])
    assert picture.has_axes == has_axes
    if has_backbone:
        np.testing.assert_array_equal(picture.target_backbone, episodes.target_backbone[0])
    else:
        assert picture.target_backbone is None
