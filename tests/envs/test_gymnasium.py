"""What Gymnasium asks of environments, in the manner of its own tests."""

import json
import subprocess
import sys
import warnings

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.error import ResetNeeded
from gymnasium.utils.env_checker import check_env
from gymnasium.vector import AsyncVectorEnv, SyncVectorEnv

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


@pytest.fixture
def no_warnings():
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        yield


@pytest.mark.parametrize(
    "task, options",
    [
        *(pytest.param(task, {**SMALL, **options}, id=mode) for mode, (task, options) in MODES.items()),
    ],
)
def test_the_checker_has_nothing_to_say(task, options, no_warnings):
    check_env(gym.make(IDS[task], **options).unwrapped, skip_render_check=True)


@pytest.mark.parametrize("task", IDS)
def test_the_checker_has_nothing_to_say_about_random_arms(task, arm, everything, no_warnings):
    check_env(gym.make(IDS[task], **arm, randomize=everything, **SENSORS).unwrapped, skip_render_check=True)


def test_spaces_and_results_have_the_promised_types(live):
    env = gym.make(IDS["TipPose"], **SMALL)
    (observation, info), (_, reward, terminated, truncated, after) = live(env, 0, 1)
    assert observation.dtype == np.float32 and env.observation_space.contains(observation)
    assert np.isfinite(env.observation_space.low).all() and np.isfinite(env.observation_space.high).all()
    assert (env.action_space.low == -1).all() and (env.action_space.high == 1).all()
    assert type(reward) is float and terminated is False and truncated is False
    assert all(type(value) in (float, int, bool) for value in {**info, **after}.values())


def printed_by(program):
    return subprocess.run([sys.executable, "-c", program], check=True, capture_output=True, text=True, timeout=200).stdout


@pytest.mark.parametrize("module", ["soft_tendon_env", "soft_tendon_env.envs"])
def test_importing_brings_no_learning_recording_or_plotting_library(module):
    program = f"import json, sys, {module}; print(json.dumps(sorted(sys.modules)))"
    loaded = set(json.loads(printed_by(program)))
    assert not loaded & {"torch", "stable_baselines3", "sb3_contrib", "rerun", "matplotlib", "matplotlib.pyplot", "pandas", "tqdm"}


def steps_until_the_end(env, seed=0):
    env.reset(seed=seed)
    for count in range(1, 2000):
        _, _, terminated, truncated, _ = env.step(np.zeros(3))
        if terminated or truncated:
            return count, terminated, truncated


@pytest.mark.parametrize("longest", [None, 7, 700])
def test_episodes_are_truncated_in_time(longest):
    env = gym.make(IDS["TipPose"], **SMALL, **({} if longest is None else {"max_episode_steps": longest}))
    assert steps_until_the_end(env) == (longest or 500, False, True)


@pytest.mark.parametrize("mode, kind", [(None, TipPoseVectorEnv), ("vector_entry_point", TipPoseVectorEnv), ("sync", SyncVectorEnv)])
def test_vector_environments_are_made_in_every_mode(mode, kind):
    env = gym.make_vec(IDS["TipPose"], num_envs=2, vectorization_mode=mode, **SMALL)
    assert isinstance(env.unwrapped, kind)
    observation, _ = env.reset(seed=0)
    assert env.observation_space.contains(observation)
    assert env.step(env.action_space.sample())[0].shape == observation.shape
    env.close()


@pytest.mark.parametrize("task", IDS)
def test_worker_processes_give_the_native_rows(task, everything, same):
    options = {**SMALL, "randomize": everything, "max_episode_steps": 6}
    workers = gym.make_vec(IDS[task], num_envs=2, vectorization_mode="async", **options)
    native = gym.make_vec(IDS[task], num_envs=2, **options)
    assert isinstance(workers, AsyncVectorEnv)
    try:
        actions = np.random.default_rng(0).uniform(-1.0, 1.0, (20, 2, 3))
        assert same(native.reset(seed=7)[0], workers.reset(seed=7)[0])
        for action in actions:
            (*step, info), (*expected, expected_info) = native.step(action), workers.step(action)
            assert same(step, expected)
            for key in (key for key in info if not key.startswith("_")):
                known = info[f"_{key}"]
                assert (info[key][known] == expected_info[key][known]).all() and expected_info[f"_{key}"][known].all()
    finally:
        workers.close()


def test_stepping_before_reset_is_refused():
    for env in (TipPoseEnv(**SMALL), TipPoseVectorEnv(num_envs=1, **SMALL)):
        with pytest.raises(ResetNeeded):
            env.step(np.zeros(env.action_space.shape))
