"""Tasks and targets that are registered, from this package and from outside: ids, classes, names in
options and in errors."""

import pickle
from dataclasses import replace
from typing import Literal

import gymnasium as gym
import numpy as np
import pytest

from soft_tendon_env.envs import IDS, TASKS, TipPoseEnv, environments
from soft_tendon_env.envs.options import Options
from soft_tendon_env.envs.targets import Course, Target
from soft_tendon_env.envs.targets.shipped import FixedPose
from soft_tendon_env.envs.tasks import TIP_POSE
from soft_tendon_env.tools.configuration import ConfigurationError
from soft_tendon_env.tools.registry import register

SMALL = {"scene": "three_tendon", "fidelity": "fast"}


@pytest.mark.parametrize("name", ["TipPose", "Shape", "Reach"])
def test_every_task_has_its_classes_and_its_id(name):
    task = TASKS[name]
    assert task.id == IDS[name]
    assert gym.spec(task.id).max_episode_steps == 500
    one = getattr(environments, f"{name}Env")
    many = getattr(environments, f"{name}VectorEnv")
    assert one.task is many.task is task
    assert one.__doc__ == task.description
    assert hasattr(one, "compute_reward") == hasattr(many, "compute_reward") == (name == "Reach")
    assert pickle.loads(pickle.dumps(one)) is one
    assert pickle.loads(pickle.dumps(many)) is many


def test_a_task_has_one_id_with_increments_and_graded_rewards(recwarn):
    env = gym.make("TendonRod-TipPose-v0", **SMALL)
    terms = {
        name.removeprefix("reward_") for name in env.reset(seed=0)[1] if name.startswith("reward_")
    }
    assert env.unwrapped.episodes.options.action == "increment"
    assert terms == {"graded_position", "graded_angle", "effort", "smoothness"}
    assert not [warning for warning in recwarn if "out of date" in str(warning.message)]
    with pytest.raises(gym.error.VersionNotFound):
        gym.make("TendonRod-TipPose-v1")


def test_a_task_from_outside_is_an_environment(forgotten):
    hover = replace(TIP_POSE, target="hold", description="Stay.")
    register("task", "Hover", hover, max_episode_steps=7)
    env = gym.make("TendonRod-Hover-v0", **SMALL)
    envs = gym.make_vec("TendonRod-Hover-v0", num_envs=2, **SMALL)
    like = TipPoseEnv(**SMALL, target="hold")
    assert type(env.unwrapped).__name__ == "HoverEnv"
    assert type(env.unwrapped).__doc__ == "Stay."
    assert env.spec.max_episode_steps == 7
    first = env.reset(seed=3)[0]
    expected = like.reset(seed=3)[0]
    np.testing.assert_array_equal(first, expected)
    np.testing.assert_array_equal(envs.reset(seed=3)[0][0], expected)
    again = pickle.loads(pickle.dumps(env.unwrapped))
    np.testing.assert_array_equal(again.reset(seed=3)[0], expected)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"errors": ()}, "the task New lacks errors"),
        ({"observations": {"all": ("rates",)}}, "the task New lacks the choice 'full'"),
        ({"reward": {"positoin": 1.0}}, "the task New names 'positoin': did you mean 'position'"),
        ({"target": "hld"}, "the task New names 'hld': did you mean 'hold'"),
        (
            {"observations": {"full": ("ratse",)}},
            "the task New names 'ratse': did you mean 'rates'",
        ),
        ({"observations": {"full": ("target_coordinates",)}}, "names 'target_coordinates'"),
        ({"measured_reference": ("preveiw",)}, "names 'preveiw': did you mean 'preview'"),
    ],
)
def test_a_task_that_names_what_does_not_exist_is_refused(changes, message):
    with pytest.raises(ValueError, match=message):
        register("task", "New", replace(TIP_POSE, **changes))
    assert "New" not in TASKS


@pytest.mark.parametrize(
    ("name", "message"),
    [
        ("hover", "one word in capitals such as 'TipPose', not 'hover'"),
        ("TendonRod", "'TendonRod' is taken, by the class TendonRodEnv"),
        ("TipPose", "'TipPose' of the task of .* is taken, by soft_tendon_env.envs.tasks"),
    ],
)
def test_names_that_no_task_may_have(name, message):
    with pytest.raises(ValueError, match=message):
        register("task", name, TIP_POSE)


class Near(Target):
    type: Literal["near"] = "near"
    distance: float

    def draw(self, generator, setting) -> Course:
        pose = np.eye(4)
        pose[0, 3] = self.distance
        return FixedPose(pose)


def test_a_target_from_outside_is_an_option(forgotten):
    with pytest.raises(
        ConfigurationError,
        match=(
            "target.type is 'near': valid: circle, circles, either, file, hold, out_of_reach, ramp"
        ),
    ):
        Options(target="near")
    assert register("target", "near")(Near) is Near
    assert register("target", "near")(Near) is Near
    for given in ({"type": "near", "distance": 0.2}, Near(distance=0.2)):
        options = Options(target=given)
        assert options.target == Near(distance=0.2)
        assert options.model_dump()["target"] == {"type": "near", "distance": 0.2}
        env = gym.make("TendonRod-TipPose-v0", **SMALL, target=given)
        env.reset(seed=0)
        assert env.unwrapped.target_at([0.0]).tip_pose[0, 0, 3] == 0.2
    with pytest.raises(ConfigurationError, match="target.distance is missing"):
        Options(target="near")
    with pytest.raises(
        ConfigurationError,
        match="target is 'near', which is a pose alone: Shape needs one that is made of tensions",
    ):
        gym.make("TendonRod-Shape-v0", **SMALL, target={"type": "near", "distance": 0.2})


def test_a_target_needs_a_name_of_its_own():
    class Other(Target):
        type: Literal["hold"] = "hold"

    with pytest.raises(
        ValueError,
        match="'hold' of the target of .* is taken, by soft_tendon_env.envs.targets.shipped",
    ):
        register("target", "hold")(Other)
