"""What Gymnasium asks of environments, in the manner of its own tests."""

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.error import ResetNeeded
from gymnasium.utils.env_checker import check_env
from gymnasium.vector import SyncVectorEnv

from soft_tendon_env.envs import IDS, TipPoseEnv, TipPoseVectorEnv

SMALL = {"scene": "three_tendon", "fidelity": "fast"}
SENSORS = {"observation": "measurable", "sensors": [0.0, 0.15, 0.3]}
MODES = {
    **{f"{task} plain": (task, {}) for task in IDS},
    **{f"{task} measurable": (task, SENSORS) for task in IDS},
    "TipPose increment": ("TipPose", {"action": "increment", "tension_rate": 20.0}),
    "TipPose far preview": ("TipPose", {"preview": [0.02, 1.0, 5.0], "history": 2}),
    "TipPose no preview": ("TipPose", {"preview": []}),
    **{f"TipPose {target}": ("TipPose", {"target": target}) for target in ("hold", "circle")},
    "Shape ramp": ("Shape", {"target": "ramp"}),
    "Reach random": ("Reach", {"target": "random", "reward": "dense", "threshold": 0.02}),
    "TipPose scene's own": ("TipPose", {"fidelity": None, "control_period": 0.05}),
}


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize("mode", MODES)
def test_the_checker_has_nothing_to_say(mode):
    task, options = MODES[mode]
    check_env(gym.make(IDS[task], **{**SMALL, **options}).unwrapped, skip_render_check=True)


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize(
    "name",
    [
        "three_tendon",
        *(pytest.param(name, marks=pytest.mark.slow) for name in ("explicit", "loads inside")),
    ],
)
@pytest.mark.parametrize("task", IDS)
def test_the_checker_has_nothing_to_say_about_random_arms(task, name, arms, everything):
    arm = arms[name]
    check_env(
        gym.make(IDS[task], **arm, randomize=everything, **SENSORS).unwrapped,
        skip_render_check=True,
    )


@pytest.mark.parametrize("longest", [None, 7, 700])
def test_episodes_are_truncated_in_time(longest):
    env = gym.make(
        IDS["TipPose"], **SMALL, **({} if longest is None else {"max_episode_steps": longest})
    )
    env.reset(seed=0)
    ends = [env.step(np.zeros(3))[2:4] for _ in range(longest or 500)]
    assert ends == [(False, False)] * (len(ends) - 1) + [(False, True)]


@pytest.mark.parametrize(
    ("mode", "kind"),
    [(None, TipPoseVectorEnv), ("vector_entry_point", TipPoseVectorEnv), ("sync", SyncVectorEnv)],
)
def test_vector_environments_are_made_in_every_mode(mode, kind):
    env = gym.make_vec(IDS["TipPose"], num_envs=2, vectorization_mode=mode, **SMALL)
    assert isinstance(env.unwrapped, kind)
    observation, _ = env.reset(seed=0)
    assert env.observation_space.contains(observation)
    assert env.step(env.action_space.sample())[0].shape == observation.shape
    env.close()


def test_stepping_before_reset_is_refused():
    for env in (TipPoseEnv(**SMALL), TipPoseVectorEnv(num_envs=1, **SMALL)):
        with pytest.raises(ResetNeeded):
            env.step(np.zeros(env.action_space.shape))
