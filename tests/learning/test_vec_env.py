"""The adapter to Stable-Baselines3 against what that does itself with single environments."""

import gymnasium as gym
import numpy as np
import pytest
from stable_baselines3 import PPO
from stable_baselines3.common.monitor import Monitor
from stable_baselines3.common.vec_env import DummyVecEnv

from soft_tendon_env.envs import IDS
from soft_tendon_env.learning.vec_env import StableBaselinesVecEnv, make_sb3_vec_env

pytestmark = pytest.mark.filterwarnings("error")

TIP_POSE = IDS["TipPose"]
SHAPE = IDS["Shape"]
REACH = IDS["Reach"]
FAST = {"scene": "three_tendon", "fidelity": "fast"}
WILD = {  # diverges at random times
    "scene": {"scene": "three_tendon", "integrator.max_halvings": 0},
    "fidelity": "scene",
    "action": "tension",
    "tension_limits": [-20.0, 20.0],
    "control_period": 0.05,
}


def timeless(value):
    """Nested values without times."""
    if isinstance(value, dict):
        return {key: timeless(entry) for key, entry in value.items() if key != "t"}
    if isinstance(value, list | tuple):
        return type(value)(map(timeless, value))
    return value


IN_TIME = (False, True)
TERMINATED = (True, False)


@pytest.mark.parametrize(
    ("id", "options", "ends"),
    [
        (TIP_POSE, {"max_episode_steps": 7, **FAST}, {IN_TIME}),
        (SHAPE, {"max_episode_steps": 7, **FAST}, {IN_TIME}),
        (REACH, {"max_episode_steps": 7, "reward": "dense", **FAST}, {IN_TIME}),
        (TIP_POSE, {"max_episode_steps": 6, **WILD}, {IN_TIME, TERMINATED}),
    ],
)
def test_rows_are_what_single_environments_are(id, options, ends, same):
    rows = 3
    rng = np.random.default_rng(0)
    seen = set()
    ours = make_sb3_vec_env(id, rows, **options)
    theirs = DummyVecEnv([lambda: Monitor(gym.make(id, **options)) for _ in range(rows)])
    assert (ours.observation_space, ours.action_space) == (
        theirs.observation_space,
        theirs.action_space,
    )
    for seed in (5, None, 6):
        if seed is not None:
            seeds = [seed, seed + 1, seed + 2]
            assert ours.seed(seed) == seeds
            assert theirs.seed(seed) == seeds
        assert same(ours.reset(), theirs.reset())
        for _ in range(30):
            drawn = rng.choice([-1.0, 1.0], (rows, *ours.action_space.shape))
            action = drawn.astype(np.float32)
            result = ours.step(action)
            expected = theirs.step(action)
            assert same(timeless(result), timeless(expected))  # infos of plain values among them
            seen |= {
                (info["diverged"], info["TimeLimit.truncated"])
                for info in result[3]
                if "episode" in info
            }
    assert seen == ends


def test_what_the_rows_share():
    env = make_sb3_vec_env(REACH, 3, reward="dense", **FAST)
    observation = env.reset()
    goals = observation["achieved_goal"], observation["desired_goal"]
    (reward,) = env.env_method("compute_reward", *goals, [{}] * 3, indices=[0])
    assert reward.shape == (3,)
    assert (reward > 0).all()
    assert len(env.env_method("compute_reward", *goals, None)) == 3
    assert env.get_attr("render_mode") == [None] * 3
    assert len(env.get_attr("episodes", indices=1)) == 1
    assert env.get_attr("observation_space", [0, 2]) == [env.observation_space] * 2
    assert env.get_attr("action_space", 0) == [env.action_space]
    assert env.has_attr("compute_reward")
    assert not env.has_attr("nothing")
    assert not make_sb3_vec_env(TIP_POSE, 1, **FAST).has_attr(
        "compute_reward"
    )  # else it would pass for goal-conditioned
    env.set_attr("label", 3)
    assert env.get_attr("label") == [3, 3, 3]
    with pytest.raises(ValueError, match="rows share 'label'"):
        env.set_attr("label", 4, indices=[0, 1])
    with pytest.raises(ValueError, match="'reset' acts on all rows"):
        env.env_method("reset", indices=0)
    assert env.env_is_wrapped(Monitor) == [True] * 3
    assert env.env_is_wrapped(gym.wrappers.TimeLimit, 0) == [False]
    assert env.spec.id == REACH
    env.close()


def test_other_environments_are_refused():
    with pytest.raises(ValueError, match="autoreset_mode='same_step', not 'next_step'"):
        StableBaselinesVecEnv(gym.make_vec(TIP_POSE, 1, **FAST))
    with pytest.raises(TypeError, match="should be a TendonRodVectorEnv"):
        StableBaselinesVecEnv(gym.make_vec("CartPole-v1", 1))


def test_rows_of_gymnasium_are_refused_in_the_words_of_the_page():
    rows = gym.make_vec(TIP_POSE, num_envs=2, **FAST)
    with pytest.raises(ValueError, match=r"^The environment is of type .*VectorEnv"):
        PPO("MlpPolicy", rows)
    rows.close()
