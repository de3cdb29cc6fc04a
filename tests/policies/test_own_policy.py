"""Policies of one's own as entrants: what they do to their environment or observations has no effect, and errors name them."""

import sys
import time
from types import SimpleNamespace

import gymnasium as gym
import numpy as np
import pytest

from soft_tendon_env.control import CONTROLLERS, ControllerOutput, Entry
from soft_tendon_env.envs import IDS
from soft_tendon_env.envs.episodes import episodes_of
from soft_tendon_env.evaluation import evaluate, evaluate_rows
from soft_tendon_env.evaluation.comparison import shared_arms
from soft_tendon_env.evaluation.entrants import believed_scene
from soft_tendon_env.evaluation.settings import EpisodeSettings
from soft_tendon_env.policies import load_policy, policy_options
from soft_tendon_env.policies.names import PolicyName
from soft_tendon_env.policies.own_policy import EntrantError, own_environment
from soft_tendon_env.tools.messages import describe

ARM = {"scene": "three_tendon", "fidelity": "fast", "randomize": {"stiffness": 1.2, "noise": {"position": 1e-3}}}
SEEDS = [3, 5]


class Honest:
    """Turns up one tendon; `cheats` before it acts."""

    options = {"observation": ["tip_position", "target_error"], "history": 1, "action": "increment"}

    def __init__(self, env):
        self.env, self.size = env, env.action_space.shape[-1]

    def predict(self, observation, state=None, episode_start=None, deterministic=False):
        self.cheat(observation)
        return self.act(np.tile(np.eye(self.size)[0], (*observation.shape[:-1], 1)).astype(np.float32))

    def act(self, action):
        return 0.3 * action, None

    def cheat(self, observation):
        pass


def by_environment(self, observation):
    """Puts the target onto the tip."""
    episodes = episodes_of(self.env)
    episodes._courses._table.pose[:] = episodes.arms.reading.tip_pose[:, None]
    self.env.reset(seed=0)


def scores_of(monkeypatch, rows=False, task="TipPose", mine=None, **members):
    """Records of the episodes of what makes a policy, by default an Honest with other members, less the time of an action."""
    module = type(sys)("entrants_of_mine")
    module.mine = mine or type("Mine", (Honest,), members)
    monkeypatch.setitem(sys.modules, module.__name__, module)
    options = policy_options("entrants_of_mine:mine", task, ARM)
    if rows:
        envs = gym.make_vec(IDS[task], num_envs=len(SEEDS), max_episode_steps=10, **options)
        scores = evaluate_rows(load_policy("entrants_of_mine:mine", envs), envs, SEEDS, 0.1)
    else:
        env = gym.make(IDS[task], max_episode_steps=10, **options)
        scores = evaluate(load_policy("entrants_of_mine:mine", env), env, SEEDS, 0.1)
    return [{key: value for key, value in score.record().items() if key != "action_time"} for score in scores]


def zero_observation(self, observation):
    observation[:] = 0.0


@pytest.mark.parametrize("rows", [False, True])
@pytest.mark.cases("cheat", [by_environment, zero_observation, lambda self, _: np.random.seed(0), lambda self, _: time.sleep(1e-3)])
def test_what_is_not_that_of_the_judged_episode_has_no_effect(monkeypatch, cheat, rows):
    assert scores_of(monkeypatch, rows, cheat=cheat) == scores_of(monkeypatch)


@pytest.mark.parametrize("rows", [False, True])
@pytest.mark.cases(
    "members, said",
    [
        ({"act": lambda self, action: (action + np.nan, None)}, r"whose action should be finite, but action\[0.* is nan"),
        ({"act": lambda self, action: (action + np.inf, None)}, "whose action should be finite"),
        ({"act": lambda self, action: (action[..., :2], None)}, r"whose action should have shape \((2, )?3,?\), not"),
        ({"act": lambda self, action: ("up", None)}, "whose action should be an array of numbers"),
        ({"act": lambda self, action: action}, "whose predict should return an action and a state, not ndarray"),
        ({"act": lambda self, action: sys.exit(0)}, "which ends the program"),
    ],
)
def test_what_no_entrant_should_do_is_told_by_its_name(monkeypatch, members, said, rows):
    with pytest.raises(EntrantError, match=f"policy is 'entrants_of_mine:mine', .*{said}"):
        scores_of(monkeypatch, rows, **members)


@pytest.mark.cases("member", ["act", "__init__"])
def test_what_a_policy_raises_names_it(monkeypatch, member):
    with pytest.raises(KeyError) as error:
        scores_of(monkeypatch, **{member: lambda self, given: {}["gain"]})
    assert error.value.__notes__ == ["It was raised in the policy entrants_of_mine:mine."]
    assert describe(error.value) == "'gain'. It was raised in the policy entrants_of_mine:mine."


@pytest.mark.cases("mine", [lambda env: None, lambda env: Honest, lambda env: SimpleNamespace(predict=3), lambda env: env])
def test_what_is_no_policy_is_told_when_it_is_made(monkeypatch, mine):
    with pytest.raises(ValueError, match="'entrants_of_mine:mine': mine should make an object with predict, or a function of observations"):
        scores_of(monkeypatch, mine=mine)


@pytest.mark.parametrize("task", IDS)
def test_a_function_gets_rows_also_where_observations_are_dictionaries(monkeypatch, task):
    seen = []

    def act(observation):
        seen.append(np.shape(observation["desired_goal"] if task == "Reach" else observation)[:-1])
        return np.zeros((*seen[-1], 3))

    alone, together = (scores_of(monkeypatch, rows, task, lambda env: act) for rows in (False, True))
    assert {*seen} == {(1,), (2,)} and alone == together


def test_a_policy_may_be_whole_numbers_beyond_its_bounds_and_reuse_an_array(monkeypatch):
    (first, _) = scores_of(monkeypatch, act=lambda self, action: (7 * action.astype(int), None))
    assert first["bound_violations"] == 10

    def reuse(self, action):
        self.kept = getattr(self, "kept", action)
        self.kept += 0.01
        return self.kept, None

    assert len(scores_of(monkeypatch, act=reuse)) == 2


@pytest.mark.cases(
    "options, said",
    [
        *(
            (
                {**Honest.options, name: value},
                f"'entrants_of_mine:mine', whose options have {name}: a policy may set observation, preview, h",
            )
            for name, value in (("control_period", 0.005), ("tension_limits", [-60, 60]), ("target", "hold"), ("randomize", {}))
        ),
        ({"scene": "paper", "fidelity": "fine", 3: 1}, "whose options have scene, fidelity, 3: a policy"),
        (["history"], r"'entrants_of_mine:mine', whose options should be a table, not \['history'\]"),
        (None, "whose options should be a table, not None"),
        ({"history": -1}, "options of entrants_of_mine:mine: history is -1: it should be greater than or equal to 0"),
    ],
)
def test_options_that_no_policy_may_set_are_refused_by_name(monkeypatch, options, said):
    with pytest.raises(ValueError, match=said):
        scores_of(monkeypatch, options=options)


@pytest.mark.parametrize("rows", [False, True])
def test_the_environment_of_its_own_is_that_of_the_arm_that_everybody_knows(rows):
    options = {**ARM, "target": "hold", "history": 1, "control_period": 0.04, "tension_limits": (0.0, 2.0)}
    env = gym.make_vec(IDS["TipPose"], num_envs=2, **options) if rows else gym.make(IDS["TipPose"], **options)
    own = own_environment(env)
    one, other = episodes_of(own), episodes_of(env)
    assert own.observation_space == env.observation_space and own.action_space == env.action_space
    assert one.period == 0.04 and np.array_equal(one.limits, other.limits) and one.model.scene == other.model.scene
    assert one.options.randomize.noise == other.options.randomize.noise and not one.options.randomize.numbers
    assert one.options.target is None
    told = believed_scene(PolicyName.parse("os.path:join", "TipPose"), {"scene": "three_tendon", "segments.0.young_modulus": 1e6})
    assert episodes_of(own_environment(env, told)).model.scene.segments[0].young_modulus == 1e6


def test_what_policies_look_at_may_differ_in_a_comparison(monkeypatch):
    scores_of(monkeypatch)
    arms = shared_arms(EpisodeSettings(options=ARM), "TipPose", ["tracking", "entrants_of_mine:mine"])
    assert arms["tracking"] == {**ARM, "preview": [0.02, 0.04]} and arms["entrants_of_mine:mine"] == {**ARM, **Honest.options}


def test_a_controller_of_ones_own_gets_copies(monkeypatch):
    """Of the limits, and the tensions at reset."""

    class Greedy:
        def __init__(self, model, limits, period):
            limits[:] = -60.0, 60.0

        def act(self, now, memory=None):
            now.tension[:] = 7.0
            return ControllerOutput(np.ones(3), report={})

    monkeypatch.setitem(CONTROLLERS["TipPose"], "greedy", Entry("takes", Greedy))
    env = gym.make(IDS["TipPose"], max_episode_steps=10, **policy_options("greedy", "TipPose", ARM))
    episodes = episodes_of(env)
    kept = [episodes.limits.copy(), episodes.start_tension.copy()]
    evaluate(load_policy("greedy", env), env, SEEDS, 0.1)
    for before, after in zip(kept, (episodes.limits, episodes.start_tension), strict=True):
        np.testing.assert_array_equal(before, after)
