"""What Gymnasium asks of environments, in the manner of its own tests."""

import json
import pickle
import subprocess
import sys
import warnings

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.error import ResetNeeded
from gymnasium.utils.env_checker import check_env
from gymnasium.vector import AsyncVectorEnv, AutoresetMode, SyncVectorEnv
from gymnasium.wrappers.vector import RecordEpisodeStatistics

import soft_tendon_env
from soft_tendon_env.envs import IDS, TipPoseEnv, TipPoseVectorEnv

SMALL = {"scene": "three_tendon", "fidelity": "fast"}
SENSORS = {"observation": "measurable", "sensors": [0.0, 0.15, 0.3]}
MODES = {
    **{f"{task} plain": (task, {}) for task in IDS},
    **{f"{task} measurable": (task, SENSORS) for task in IDS},
    "TipPose groups": ("TipPose", {"observation": ["tip_position", "target_error"]}),
    "Shape groups": ("Shape", {"observation": ["coordinates", "target_coordinates", "target_lengths"]}),
    "Reach groups": ("Reach", {"observation": ["tip_position"]}),
    "TipPose increment": ("TipPose", {"action": "increment", "tension_rate": 20.0}),
    "TipPose far preview": ("TipPose", {"preview": [0.02, 1.0, 5.0]}),
    "TipPose no preview": ("TipPose", {"preview": []}),
    **{f"TipPose {target}": ("TipPose", {"target": target}) for target in ("random", "hold", "circle", "ramp")},
    **{f"Shape {target}": ("Shape", {"target": target}) for target in ("random", "hold", "ramp")},
    **{f"Reach {target}": ("Reach", {"target": target}) for target in ("random", "circle", "ramp")},
    "TipPose pose": ("TipPose", {"target": {"type": "hold", "pose": np.eye(4).tolist()}}),
    "Reach dense": ("Reach", {"reward": "dense", "threshold": 0.02}),
    **{f"TipPose {fidelity}": ("TipPose", {"fidelity": fidelity}) for fidelity in ("standard", "fine")},
    "TipPose scene's own": ("TipPose", {"fidelity": None, "control_period": 0.05}),
}


@pytest.fixture
def no_warnings():
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        yield


ALONE = [*((task, {}) for task in IDS), *(("TipPose", {"scene": scene}) for scene in soft_tendon_env.scene_names())]


@pytest.mark.parametrize(
    "task, options",
    [
        *(pytest.param(task, {**SMALL, **options}, id=mode) for mode, (task, options) in MODES.items()),
        *(pytest.param(*own, marks=pytest.mark.slow) for own in ALONE),
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


@pytest.mark.parametrize("task", IDS)
def test_a_pickled_environment_lives_alike(task, everything, live, same):
    env = gym.make(IDS[task], **SMALL, randomize=everything)
    live(env, 1, 5)
    again = pickle.loads(pickle.dumps(env))
    assert same(live(env, 2, 30), live(again, 2, 30))


def printed_by(program):
    return subprocess.run([sys.executable, "-c", program], check=True, capture_output=True, text=True, timeout=200).stdout


def test_a_fresh_process_makes_the_id_by_its_module_and_lives_alike(live):
    history = live(gym.make(IDS["TipPose"], **SMALL, randomize={"stiffness": [0.9, 1.1]}), 11, 30)
    program = f"""
import gymnasium as gym, numpy as np
env = gym.make("soft_tendon_env:TendonRod-TipPose-v0", **{SMALL!r}, randomize={{"stiffness": [0.9, 1.1]}})
actions = np.random.default_rng(11).uniform(-1.0, 1.0, (30, 3))
print(env.reset(seed=11)[0].tobytes().hex(), *(env.step(action)[0].tobytes().hex() for action in actions))
"""
    assert printed_by(program).split() == [step[0].tobytes().hex() for step in history]


@pytest.mark.parametrize("module", ["soft_tendon_env", "soft_tendon_env.envs"])
def test_importing_brings_no_learning_recording_or_plotting_library(module):
    program = f"import json, sys, {module}; print(json.dumps(sorted(sys.modules)))"
    loaded = set(json.loads(printed_by(program)))
    assert not loaded & {"torch", "stable_baselines3", "sb3_contrib", "rerun", "matplotlib", "matplotlib.pyplot", "pandas", "tqdm"}


def test_an_arm_without_tables_or_loads_starts_without_scipys_slow_imports():
    program = f"""
import json, sys, gymnasium as gym
env = gym.make("soft_tendon_env:TendonRod-TipPose-v0", **{SMALL!r})
env.reset(seed=0), env.step(env.action_space.sample())
print(json.dumps(sorted(sys.modules)))
"""
    assert not set(json.loads(printed_by(program))) & {"scipy.interpolate", "scipy.optimize"}


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


def test_without_a_limit_episodes_and_targets_go_on():
    env, position = TipPoseEnv(**SMALL), []
    env.reset(seed=0)
    for _ in range(1100):
        assert env.step(np.zeros(3))[2:4] == (False, False)
        position.append(env.episodes.target_pose[0, :3, 3])
    moved = np.linalg.norm(np.diff(position, axis=0), axis=1)
    assert moved.min() > 0.0 and moved.max() < 20 * np.median(moved)  # no jump where the next chunk of samples begins
    np.testing.assert_allclose(position[500:1000], position[:500], atol=1e-12)  # the period of 10 s


@pytest.mark.parametrize("mode, kind", [(None, TipPoseVectorEnv), ("vector_entry_point", TipPoseVectorEnv), ("sync", SyncVectorEnv)])
def test_vector_environments_are_made_in_every_mode(mode, kind):
    env = gym.make_vec(IDS["TipPose"], num_envs=2, vectorization_mode=mode, **SMALL)
    assert isinstance(env.unwrapped, kind)
    observation, _ = env.reset(seed=0)
    assert env.observation_space.contains(observation)
    assert env.step(env.action_space.sample())[0].shape == observation.shape
    env.close()


def test_the_vector_id_has_the_spec_s_time_limit():
    env = gym.make_vec(IDS["TipPose"], num_envs=2, **SMALL)
    assert env.metadata["autoreset_mode"] is AutoresetMode.NEXT_STEP
    env.reset(seed=0)
    ends = [env.step(np.zeros((2, 3)))[3].all() for _ in range(500)]
    assert ends.index(True) == 499


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


def test_gymnasium_s_statistics_count_rows_rightly():
    env = RecordEpisodeStatistics(gym.make_vec(IDS["TipPose"], num_envs=3, max_episode_steps=4, **SMALL))
    env.reset(seed=0)
    total, lengths = np.zeros(3), []
    for i in range(10):
        _, reward, _, truncated, info = env.step(np.zeros((3, 3)))
        total = reward if i == 5 else total + reward
        if truncated.any():
            lengths.append(i)
            assert (info["episode"]["l"] == 4).all()
            np.testing.assert_allclose(info["episode"]["r"], total, rtol=1e-6)
    assert lengths == [3, 8]  # the steps between are the resets


def test_stepping_before_reset_is_refused():
    for env in (TipPoseEnv(**SMALL), TipPoseVectorEnv(num_envs=1, **SMALL)):
        with pytest.raises(ResetNeeded):
            env.step(np.zeros(env.action_space.shape))
