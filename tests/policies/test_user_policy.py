"""Policies of one's own as entrants: what they do to their environment or observations has no
effect, and errors name them."""

import sys

import gymnasium as gym
import numpy as np
import pytest

from soft_tendon_env.envs import IDS
from soft_tendon_env.envs.episodes import episodes_of
from soft_tendon_env.evaluation import evaluate, evaluate_rows
from soft_tendon_env.policies import load_policy, policy_options
from soft_tendon_env.policies.names import policy_environment
from soft_tendon_env.scene.file import load_scene

ARM = {
    "scene": "three_tendon",
    "fidelity": "fast",
    "randomize": {"stiffness": 1.2, "noise": {"position": 1e-3}},
}
SEEDS = [3, 5]


class Honest:
    """Turns up one tendon; `cheats` before it acts."""

    options = {"observation": ["tip_position", "target_error"], "history": 1, "action": "increment"}
    cheat = act = staticmethod(lambda *given: given[-1])

    def __init__(self, env):
        self.env = env
        self.size = env.action_space.shape[-1]

    def predict(self, observation, state=None, episode_start=None, deterministic=False):
        self.cheat(observation)
        return (
            self.act(
                0.3 * np.tile(np.eye(self.size)[0], (*observation.shape[:-1], 1)).astype(np.float32)
            ),
            None,
        )


def by_environment(self, observation):
    """Puts the target onto the tip."""
    episodes = episodes_of(self.env)
    episodes.trajectories._table.pose[:] = episodes.arms.reading.tip_pose[:, None]
    self.env.reset(seed=0)


def scores_of(monkeypatch, rows=False, mine=None, **members):
    """Records of the episodes of what makes a policy, by default an Honest with other members, less
    the time of an action."""
    module = type(sys)("policies_of_mine")
    module.mine = mine or type("Mine", (Honest,), members)
    monkeypatch.setitem(sys.modules, module.__name__, module)
    options = policy_options("policies_of_mine:mine", "TipPose", ARM)
    if rows:
        envs = gym.make_vec(IDS["TipPose"], num_envs=len(SEEDS), max_episode_steps=10, **options)
        scores = evaluate_rows(load_policy("policies_of_mine:mine", envs), envs, SEEDS, 0.1)
    else:
        env = gym.make(IDS["TipPose"], max_episode_steps=10, **options)
        scores = evaluate(load_policy("policies_of_mine:mine", env), env, SEEDS, 0.1)
    return [
        {key: value for key, value in vars(score).items() if key != "action_time"}
        for score in scores
    ]


@pytest.mark.parametrize("rows", [False, True])
@pytest.mark.parametrize("cheat", [by_environment, lambda self, observation: observation.fill(0.0)])
def test_what_is_not_that_of_the_judged_episode_has_no_effect(monkeypatch, cheat, rows):
    assert scores_of(monkeypatch, rows, cheat=cheat) == scores_of(monkeypatch)


@pytest.mark.parametrize("rows", [False, True])
def test_the_environment_of_its_own_is_that_of_the_arm_that_everybody_knows(rows):
    options = {
        **ARM,
        "target": "hold",
        "history": 1,
        "control_period": 0.04,
        "tension_limits": (0.0, 2.0),
    }
    env = (
        gym.make_vec(IDS["TipPose"], num_envs=2, **options)
        if rows
        else gym.make(IDS["TipPose"], **options)
    )
    known = policy_environment(env)
    one = episodes_of(known)
    other = episodes_of(env)
    assert known.observation_space == env.observation_space
    assert known.action_space == env.action_space
    assert one.period == 0.04
    assert np.array_equal(one.limits, other.limits)
    assert one.model.scene == other.model.scene
    assert one.options.randomize.noise == other.options.randomize.noise
    assert not one.options.randomize.numbers
    assert one.options.target is None
    told = load_scene("three_tendon").replace({"segments.0.young_modulus": 1e6})
    assert episodes_of(policy_environment(env, told)).model.scene.segments[0].young_modulus == 1e6


@pytest.mark.parametrize(
    ("members", "said"),
    [
        ({"act": lambda self, action: action + np.nan}, "action"),
        ({"act": lambda self, action: action[..., :2]}, "action"),
        (
            {"options": {"control_period": 0.005}},
            "whose options have control_period: it may set observation, preview, h",
        ),
        (
            {"options": {"history": -1}},
            (
                "options of policies_of_mine:mine: history is -1: it should be greater than or"
                " equal to 0"
            ),
        ),
        (
            {"action_space": gym.spaces.Box(0, 1, (7,))},
            r"mine', made for the action_space Box.0.0, 1.0, .7,., float32.: the environment's",
        ),
        ({"mine": lambda env: None}, "mine should make an object with predict, not None"),
    ],
)
def test_what_no_policy_should_do_is_refused(monkeypatch, members, said):
    with pytest.raises((ValueError, AssertionError), match=said):
        scores_of(monkeypatch, **members)


def test_an_agent_of_another_fidelity_is_told_which_groups_differ(monkeypatch):
    """One of Stable-Baselines3 knows the size of its observation alone."""
    names = ["coordinates", "tip_position", "rates", "last_action"]
    trained = gym.make(IDS["TipPose"], **{**ARM, "randomize": {}}, observation=names)

    class Foreign(Honest):
        observation_space = trained.observation_space
        options = {"observation": names}

    module = type(sys)("policies_of_another")
    module.agent = Foreign
    monkeypatch.setitem(sys.modules, module.__name__, module)
    finer = {**ARM, "fidelity": "standard"}
    env = gym.make(IDS["TipPose"], **policy_options("policies_of_another:agent", "TipPose", finer))
    count = trained.unwrapped.model.coordinate_count
    with pytest.raises(ValueError, match="coordinates, rates have an entry for each of") as error:
        load_policy("policies_of_another:agent", env)
    text = str(error.value)
    assert f"coordinates ({env.unwrapped.model.coordinate_count}), tip_position (3), " in text
    assert f"an arm with {count} has observations of that size" in text
    assert "here 'standard'" in text
    Foreign.observation_space = gym.spaces.Box(-1.0, 1.0, (7,))  # of no arm
    with pytest.raises(ValueError, match="the fidelity, here 'standard'$"):
        load_policy("policies_of_another:agent", env)
    # without groups of coordinates the sizes alone are told
    other = gym.make(IDS["TipPose"], **ARM, observation=["tip_position", "last_action"])
    with pytest.raises(ValueError, match=r"It has tip_position \(3\), last_action \(3\)$"):
        load_policy("policies_of_another:agent", other)
    Foreign.observation_space = other.observation_space
    assert load_policy("policies_of_another:agent", other) is not None
