"""Rewards: terms between 0 and 1, their weighted mean, and the goals' rewards once more from
outside; units of errors."""

import numpy as np
import pytest

from soft_tendon_env.envs import (
    ReachEnv,
    ReachVectorEnv,
    ShapeEnv,
    TipPoseEnv,
    TipPoseVectorEnv,
)
from soft_tendon_env.envs.kernels import closeness
from soft_tendon_env.envs.tracking import goal_reward
from soft_tendon_env.tools.configuration import ConfigurationError
from soft_tendon_env.tools.registry import register

SMALL = {"scene": "three_tendon", "fidelity": "fast"}
WEIGHTS = {
    TipPoseEnv: {"graded_position": 1.0, "graded_angle": 0.25, "effort": 0.02, "smoothness": 0.1},
    ShapeEnv: {"graded_backbone": 1.0, "effort": 0.02, "smoothness": 0.1},
}
DRAWN = {"stiffness": [0.5, 2.0], "payload": [0.0, 0.02]}
HANGING = {"scene": "three_tendon", "effects.gravity.acceleration": [0.0, 0.0, -9.81]}


def steps(env, count=30, seed=0):
    env.reset(seed=seed)
    rng = np.random.default_rng(seed)
    for _ in range(count):
        yield env.step(rng.uniform(-1, 1, env.action_space.shape))


@pytest.mark.parametrize("kind", WEIGHTS)
def test_the_reward_is_the_weighted_mean_of_the_terms_in_info(kind):
    weights = WEIGHTS[kind]
    for _, reward, _, _, info in steps(kind(**SMALL)):
        terms = {
            name.removeprefix("reward_"): value
            for name, value in info.items()
            if name.startswith("reward_")
        }
        assert terms.keys() == weights.keys()
        assert all(0.0 <= value <= 1.0 for value in terms.values())
        assert reward == pytest.approx(
            sum(weights[name] * terms[name] for name in terms) / sum(weights.values()), rel=1e-14
        )


def test_a_term_of_several_scales_is_the_mean_of_those():
    env = ShapeEnv(
        **SMALL,
        reward={
            "backbone": {"scale": [0.01, 0.1, 1.0]},
            "position": {"weight": 0.5, "scale": [0.2]},
        },
    )
    for _, reward, _, _, info in steps(env):
        each = [closeness(info["backbone_error"], scale) for scale in (0.01, 0.1, 1.0)]
        expected_reward_backbone = np.mean(each)
        assert info["reward_backbone"] == pytest.approx(expected_reward_backbone, rel=1e-14)
        assert info["reward_position"] == pytest.approx(
            closeness(info["position_error"], 0.2), rel=1e-14
        )
        assert reward == pytest.approx(
            (info["reward_backbone"] + 0.5 * info["reward_position"]) / 1.5, rel=1e-14
        )


def test_graded_terms_tell_small_errors_apart_as_large_ones():
    """An error of ten times as much costs about a fifth of the term, from a thousandth of the rod's
    length to all of it."""
    env = TipPoseEnv(**SMALL)
    for _, _, _, _, info in steps(env, 5):
        each = [
            closeness(info["position_error"], grade * 0.05 * env.model.length)
            for grade in (4.0, 0.4, 0.04)
        ]
        expected_reward_graded_position = np.mean(each)
        assert info["reward_graded_position"] == pytest.approx(
            expected_reward_graded_position, rel=1e-14
        )
    values = goal_reward(
        np.outer(0.05 * 10.0 ** np.arange(-2, 2), [1.0, 0.0, 0.0]),
        np.zeros((4, 3)),
        0.01,
        dense=True,
    )
    assert (-np.diff(values) > 0.2).all()
    assert values[0] > 0.9


def test_terms_are_what_they_say():
    env = TipPoseEnv(**SMALL, action="tension")
    env.reset(seed=0)
    _, _, _, _, info = env.step([1.0, 0.0, -1.0])  # 5, 2.5 and 0 of 5 N
    expected_reward_effort = 1 - (1 + 0.25) / 3
    assert info["reward_effort"] == pytest.approx(expected_reward_effort)
    assert info["reward_smoothness"] == pytest.approx(
        1 - (1 + 0.25) / 3
    )  # from -1, -1, -1; a change of 2 counts as 1
    pose = env.episodes.arms.reading.tip_pose[0]
    target = env.episodes.target_pose[0]
    assert info["position_error"] == pytest.approx(
        np.linalg.norm(pose[:3, 3] - target[:3, 3]), rel=1e-12
    )
    angle = np.arccos((np.trace(pose[:3, :3].T @ target[:3, :3]) - 1) / 2)
    assert info["angle_error"] == pytest.approx(angle, rel=1e-6)
    assert env.step([1.0, 0.0, -1.0])[4]["reward_smoothness"] == 1.0


@pytest.mark.parametrize("kind", ["sparse", "dense"])
def test_compute_reward_gives_the_rewards_of_the_steps(kind):
    options = {
        **SMALL,
        "reward": kind,
        "threshold": 0.06,
        "randomize": {"noise": {"position": 0.01}},
    }
    env = ReachEnv(**options)
    achieved = []
    desired = []
    rewards = []
    for observation, reward, _, _, info in steps(env, 60, seed=1):
        one = env.compute_reward(observation["achieved_goal"], observation["desired_goal"], info)
        assert type(one) is float
        assert one == reward
        assert info["is_success"] is bool(
            np.linalg.norm(observation["achieved_goal"] - observation["desired_goal"]) <= 0.06
        )
        achieved.append(observation["achieved_goal"])
        desired.append(observation["desired_goal"])
        rewards.append(reward)
    assert len(set(rewards)) > 1
    assert all(0.0 <= reward <= 1.0 for reward in rewards)
    many = env.compute_reward(np.array(achieved), np.array(desired), [{}] * 60)
    assert many.shape == (60,)
    assert many.tolist() == rewards
    assert (
        env.compute_reward(
            np.array(achieved).reshape(6, 10, 3), np.array(desired).reshape(6, 10, 3), None
        )
        .ravel()
        .tolist()
        == rewards
    )


def test_a_term_of_a_users_own_is_a_function_of_the_tracking(forgotten):
    """Single and rows alike, beside others and alone."""

    @register("reward_term", "straightness")
    def straightness(tracking):
        """Strains that are small."""
        return 1.0 / (1.0 + np.abs(tracking.reading.strain[..., :3]).max(axis=(1, 2)))

    options = {**SMALL, "sensors": 3, "reward": {"straightness": 3.0, "position": 1.0}}
    env = TipPoseEnv(**options)
    rows = TipPoseVectorEnv(2, **options)
    alone = TipPoseEnv(**{**options, "reward": {"straightness": 0.1}})
    for each in (env, rows, alone):
        each.reset(seed=0)
    for _ in range(3):
        _, reward, _, _, info = env.step([1.0, -1.0, 0.0])
        many = rows.step(np.tile([1.0, -1.0, 0.0], (2, 1)))
        assert alone.step([1.0, -1.0, 0.0])[1] == info["reward_straightness"] < 1.0
        assert (
            reward
            == pytest.approx(
                0.75 * info["reward_straightness"] + 0.25 * info["reward_position"], rel=1e-14
            )
            == many[1][0]
        )
        assert {*env.episodes.terms} == {"straightness", "position"}
        assert many[4]["reward_straightness"][0] == info["reward_straightness"]


@pytest.mark.parametrize(
    "value",
    [
        lambda tracking: 0.5,
        lambda tracking: tracking.distance + 1.0,
        lambda tracking: np.nan * tracking.distance,
    ],
)
def test_terms_of_a_users_own_have_values_between_0_and_1(forgotten, value):
    register("reward_term", "wrong", value)
    env = TipPoseEnv(**SMALL, reward={"wrong": 1.0})
    with pytest.raises(
        ValueError, match=r"'wrong' should have values of shape \(1,\) between 0 and 1, not"
    ):
        env.reset(seed=0)


def test_a_term_of_a_users_own_knows_the_time(forgotten):
    @register("reward_term", "late")
    def late(tracking):
        """From the third period on."""
        assert np.array_equal(tracking.time, 0.02 * tracking.step_count)
        return (tracking.time > 0.05).astype(float)

    options = {**SMALL, "reward": {"late": 1.0}}
    env = TipPoseEnv(**options)
    rows = TipPoseVectorEnv(2, **options)
    for _ in range(2):
        rows.reset(seed=0)
        found = [
            (reward, rows.step(np.zeros((2, 3)))[1].tolist()) for _, reward, *_ in steps(env, 4)
        ]
        assert found == [(0.0, [0.0] * 2)] * 2 + [(1.0, [1.0] * 2)] * 2


@pytest.mark.parametrize(
    ("name", "scale", "shown"),
    [("effort", 2.0, "2.0"), ("smoothness", [1.0, 2.0], "1.0, 2.0"), ("own", 0.1, "0.1")],
)
def test_scales_of_terms_that_have_none_are_refused(forgotten, name, scale, shown):
    @register("reward_term", "own")
    def own(tracking):
        return np.ones(len(tracking.distance))

    with pytest.raises(
        ConfigurationError,
        match=(
            rf"reward\.{name}\.scale is {shown}: .*; those with a scale are position,"
            r" graded_position"
        ),
    ):
        TipPoseEnv(**SMALL, reward={"position": 1.0, name: {"scale": scale}})


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore:.*has no passive fields")
@pytest.mark.parametrize(
    "options",
    [
        {"scene": "three_tendon", "threshold": 0.02},
        {"scene": "three_tendon", "threshold": 0.02, "target": "steps"},
        {
            "scene": {"scene": "three_tendon", "effects.gravity.acceleration": [0.0, 0.0, -9.81]},
            "threshold": 0.02,
            "target": "random",
        },
        {"scene": "catheter", "target": {"type": "hold", "fraction": 0.02}},
        {"scene": HANGING, "threshold": 0.02, "randomize": DRAWN},
    ],
)
def test_no_drawn_goal_is_reached_before_the_first_action(options):
    """The same goals for one row and for many."""
    env = ReachEnv(fidelity="fast", **options)
    rows = ReachVectorEnv(40, fidelity="fast", **options)
    begun = [env.reset(seed=seed) for seed in range(40)]
    assert not any(info["is_success"] for _, info in begun)
    observation, info = rows.reset(seed=0)
    assert (
        observation["desired_goal"] == np.array([first["desired_goal"] for first, _ in begun])
    ).all()
    assert not info["is_success"].any()
    assert min(info["position_error"]) > env.episodes.threshold


def test_a_goal_that_can_only_be_reached_is_taken_with_a_word():
    for kind in ("hold", "random"):
        env = ReachEnv(
            scene="three_tendon", fidelity="fast", target={"type": kind, "fraction": 0.002}
        )
        with pytest.warns(
            UserWarning, match="within the threshold, 3 mm, of where the tip begins in 200 draws"
        ):
            assert env.reset(seed=0)[1]["is_success"]
    assert ReachEnv(scene="three_tendon", fidelity="fast", target="ramp").reset(seed=0)[1][
        "is_success"
    ], "a ramp begins at rest"
    assert ReachEnv(
        scene="three_tendon", fidelity="fast", target={"type": "hold", "tension": [0, 0, 0]}
    ).reset(seed=0)[1]["is_success"]
