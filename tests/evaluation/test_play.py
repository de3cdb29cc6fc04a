"""A policy lives through the same episodes whatever it is, with the environment's numbers; the
baselines solve their environments."""

import math

import gymnasium as gym
import numpy as np
import pytest

from soft_tendon_env.envs import IDS, TipPoseEnv
from soft_tendon_env.evaluation import (
    EVALUATION_SEEDS,
    MODEL_ERRORS,
    evaluate,
    evaluate_rows,
    model_error,
)
from soft_tendon_env.evaluation.play import play
from soft_tendon_env.evaluation.summaries import summarise
from soft_tendon_env.policies import make_policy, observation_options

SMALL = {"scene": "three_tendon", "fidelity": "fast"}
STEPS = 8
DEGREE = math.radians(1.0)


def make(task="TipPose", **options):
    return gym.make(IDS[task], max_episode_steps=STEPS, **{**SMALL, **options})


class Constant:
    """The same action always; counts its calls in the state that it gives back."""

    def __init__(self, *action):
        self.action = np.array(action, dtype=np.float32)
        self.calls = []

    def predict(self, observation, state=None, episode_start=None, deterministic=False):
        self.calls.append((state, bool(episode_start[0]), deterministic))
        return self.action, 1 if state is None else state + 1


def test_a_constant_pull_is_scored_as_it_acts():
    env = make(action="tension")
    least, greatest = env.unwrapped.episodes.limits.T
    action = np.array([-0.5, 0.0, 0.5])
    wanted = least + 0.5 * (greatest - least) * (action + 1.0)
    (found,) = evaluate(Constant(*action), env, [3], skip=0.0)
    expected_effort = np.sqrt(np.mean(wanted**2))
    assert found.metrics["effort"] == pytest.approx(expected_effort)
    assert (found.seed, found.steps, found.diverged, found.reached) == (
        3,
        STEPS,
        None,
        None,
    )
    assert found.action_time > 0.0


def make_rows(task="TipPose", rows=3, **options):
    return gym.make_vec(
        IDS[task], num_envs=rows, **{"max_episode_steps": STEPS, **SMALL, **options}
    )


@pytest.mark.parametrize("task", IDS)
def test_rows_live_through_the_episodes_of_single_environments(task):
    seeds = [7, 1, 4]
    controller = "feedforward"
    options = {"preview": [0.02 * k for k in range(1, 11)]}
    env = make(task, **options)
    envs = make_rows(task, **options)
    ones = [play(make_policy(controller, env), env, [seed])[0] for seed in seeds]
    together = play(make_policy(controller, envs), envs, seeds)
    for one, row in zip(ones, together, strict=True):
        assert (one.seed, one.reached, one.cause, one.period, one.length) == (
            row.seed,
            row.reached,
            row.cause,
            row.period,
            row.length,
        )
        for name in one.errors:
            np.testing.assert_array_equal(one.errors[name], row.errors[name])
        for name in ("reward", "tension", "tip_position", "target_position"):
            np.testing.assert_array_equal(getattr(one, name), getattr(row, name))
        distance = np.linalg.norm(one.target_position - one.tip_position, axis=1)
        np.testing.assert_allclose(distance, one.errors["position_error"], atol=1e-12)
        assert len(row.seconds) == STEPS
        assert (row.seconds > 0.0).all()


def test_a_row_that_diverges_ends_alone():
    env = make_rows(max_episode_steps=10, action="tension", tension_limits=(-600.0, 0.0))
    action = np.full((3, 3), 1.0, dtype=np.float32)
    action[1] = -1.0  # a push that no strain withstands

    class Pushes:
        def predict(self, observation, state=None, episode_start=None, deterministic=False):
            return action, None

    scores = evaluate_rows(Pushes(), env, [0, 1, 2], skip=0.0)
    assert [score.diverged is None for score in scores] == [True, False, True]
    assert scores[1].steps < 10
    assert scores[0].steps == scores[2].steps == 10


@pytest.mark.parametrize(
    ("play_on", "make_env", "seeds", "error", "said"),
    [
        (evaluate_rows, make_rows, [0, 1], ValueError, "one for each of the 3 rows, not 2"),
        (
            evaluate_rows,
            lambda: make_rows(autoreset_mode="same_step"),
            [0, 1, 2],
            ValueError,
            "next_step",
        ),
        (
            evaluate_rows,
            lambda: make_rows(max_episode_steps=None),
            [0, 1, 2],
            ValueError,
            "max_episode_steps",
        ),
        (
            evaluate_rows,
            lambda: gym.make_vec("CartPole-v1", num_envs=3),
            [0, 1, 2],
            TypeError,
            "gym.make_vec",
        ),
        (evaluate, lambda: gym.make("Pendulum-v1"), [0], TypeError, "env should be a TendonRodEnv"),
        (evaluate, lambda: TipPoseEnv(**SMALL), [0], ValueError, "env should end its episodes"),
    ],
)
def test_environments_that_cannot_be_evaluated_are_refused(play_on, make_env, seeds, error, said):
    with pytest.raises(error, match=said):
        play_on(Constant(0.0, 0.0, 0.0), make_env(), seeds)


@pytest.mark.parametrize("error", MODEL_ERRORS)
def test_a_seed_has_the_same_target_whatever_the_arm_has(error):
    env, nominal = (
        make(randomize=MODEL_ERRORS[error].randomize, preview=[0.02], action="increment"),
        make(),
    )
    for each in (env, nominal):
        each.reset(seed=EVALUATION_SEEDS[0])
    np.testing.assert_array_equal(
        *(each.unwrapped.target_at([0.0, 0.7, 3.0]).tip_pose for each in (env, nominal))
    )


def test_an_arm_has_several_model_errors_at_once():
    several = "stiffness+20%,payload-20g,latency-20ms"
    assert model_error(several).randomize == {"stiffness": 1.2, "payload": 0.02, "latency": 0.02}
    assert model_error("nominal").randomize == {}
    assert model_error("nominal,noise").randomize == MODEL_ERRORS["noise"].randomize
    with pytest.raises(
        ValueError,
        match="names 'stiffness-20%,noise,stiffness[+]20%', in which stiffness is said twice",
    ):
        model_error("stiffness-20%,noise,stiffness+20%")
    with pytest.raises(ValueError, match="did you mean 'payload-20g'"):
        model_error("noise,payload-20")


@pytest.mark.parametrize("rows", [False, True])
@pytest.mark.parametrize(
    ("target", "jumped"),
    [({"type": "steps", "duration": 0.08}, True), ("random", False), ("hold", False)],
)
def test_a_jump_in_the_last_step_is_that_of_the_target(target, jumped, rows):
    env, still = (
        (make_rows if rows else make)(target=target),
        Constant(*(np.full((3, 3), -1.0) if rows else np.full(3, -1.0))),
    )
    assert {episode.jumped for episode in play(still, env, [0, 1, 2] if rows else [0])} == {jumped}


@pytest.mark.slow
@pytest.mark.parametrize(
    ("task", "name", "fidelity", "bounds"),
    [
        ("TipPose", "predictive", None, {"position_error": 2e-4, "angle_error": 0.1 * DEGREE}),
        ("TipPose", "tracking", None, {"position_error": 1e-3, "angle_error": 0.3 * DEGREE}),
        ("Shape", "predictive", None, {"backbone_error": 5e-4}),
        ("Shape", "tracking", None, {"backbone_error": 1e-3}),
        ("Reach", "predictive", None, {"position_error": 1e-4}),
        (
            "Reach",
            "tracking",
            "scene",
            {"position_error": 1e-4},
        ),  # the arm without passive fields, for which its bound was set
    ],
)
def test_targets_are_tracked_and_goals_reached(task, name, fidelity, bounds):
    """From 1 s on; bounds are two to eight times what was measured when they were set."""
    env, seeds = (
        gym.make(IDS[task], fidelity=fidelity, **observation_options(name, task)),
        EVALUATION_SEEDS[:3],
    )
    summary = summarise(evaluate(make_policy(name, env), env, seeds))
    assert (summary.episodes, summary.diverged) == (len(seeds), 0)
    assert all(summary.errors[error].rms < bound for error, bound in bounds.items())
    assert summary.reached == 1.0 if task == "Reach" else summary.settled == summary.episodes
