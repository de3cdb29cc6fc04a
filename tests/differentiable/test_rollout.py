"""Rollouts in PyTorch: the environment's own episode and observation, and gradients, of logarithms
and clips too, against differences."""

from contextlib import nullcontext

import gymnasium as gym
import numpy as np
import pytest
import torch
from gymnasium.error import ResetNeeded

from soft_tendon_env import build_model, load_scene, register
from soft_tendon_env.control.rigid_motions import moved_pose, pose_error
from soft_tendon_env.differentiable import (
    GradientWarning,
    gradient_accuracy,
    inward_clip,
    pose_logarithm,
    rollout,
)
from soft_tendon_env.differentiable.accuracy import check_gradients
from soft_tendon_env.differentiable.actuation import TensorActuation
from soft_tendon_env.differentiable.poses import body_cotangent
from soft_tendon_env.envs import IDS, TASKS
from soft_tendon_env.envs.episodes import episodes_of
from soft_tendon_env.envs.observation import HISTORY, Group

SMALL = {"scene": "three_tendon", "fidelity": "fast"}
SHIPPED = ["TipPose", "Shape", "Reach"]


def rows_of(task, rows=3, **options):
    return gym.make_vec(
        IDS[task], num_envs=rows, max_episode_steps=None, threads=1, **{**SMALL, **options}
    )


@pytest.mark.parametrize("task", SHIPPED)
@pytest.mark.parametrize(
    ("action", "rate_limit"), [("tension", None), ("increment", None), ("tension", 30.0)]
)
def test_a_rollout_is_the_environments_own_episode(task, action, rate_limit, everything, same):
    """Every group, under all that is drawn: states bit for bit, observations to the rounding of
    float32."""
    options = {
        "observation": [*TASKS[task].observable],
        "randomize": everything,
        "action": action,
        "rate_limit": rate_limit,
        "sensors": 2,
        "preview": [0.02, 0.1],
        "history": 2,
    }
    envs = rows_of(task, **options)
    other = rows_of(task, **options)
    envs.reset(seed=3)
    rng = np.random.default_rng(0)
    actions = torch.tensor(rng.uniform(-1.2, 1.2, (5, 3, 3)))
    seen = []

    def policy(observation):
        seen.append(observation)
        return actions[len(seen) - 1]

    expected = [other.reset(seed=3)[0]]
    found = rollout(envs, policy, len(actions))
    expected += [other.step(action.numpy())[0] for action in found.action]
    for observation, wanted in zip([*seen, found.observation], expected, strict=True):
        assert_observations_equal(observation, wanted, episodes_of(envs).layout.slices)
    mine = episodes_of(envs)
    its = episodes_of(other)
    assert all(
        same(getattr(mine.arms.rows, name), getattr(its.arms.rows, name))
        for name in ("q", "q_dot", "xi")
    )
    assert same(found.q[-1].numpy(), its.arms.rows.q)
    assert same(mine.observation(), its.observation())
    errors = [
        pose_error(pose, wanted)
        for pose, wanted in zip(its.arms.reading.tip_pose, its.target_pose, strict=True)
    ]
    np.testing.assert_array_equal(found.error[-1], errors)
    np.testing.assert_array_equal(
        found.backbone_error[-1], its.target_backbone - its.arms.reading.backbone[..., :3, 3]
    )
    if task == "Shape":
        rewarded = found.backbone_error[-1].square().sum(-1).mean(-1).sqrt()
        np.testing.assert_allclose(rewarded, its.errors["backbone_error"], rtol=1e-12)


def assert_observations_equal(observation, wanted, slices):
    if isinstance(wanted, dict):
        for name in ("achieved_goal", "desired_goal"):
            np.testing.assert_allclose(observation[name], wanted[name], atol=1e-7)
        observation = observation["observation"]
        wanted = wanted["observation"]
    assert observation.dtype == torch.float32
    assert observation.shape == wanted.shape
    for name, where in slices.items():  # a history has differences of such numbers over a tenth
        tolerance = 2e-5 if name == HISTORY else 1e-6
        np.testing.assert_allclose(
            observation[:, where], wanted[:, where], rtol=1e-6, atol=tolerance, err_msg=name
        )


OBSERVED = ["tip_position", "strain_rate", "tendon_lengths", "target_error", "command"]
TENSE = {"action": "tension", "observation": OBSERVED, "sensors": 1, "history": 1}
LOADED = {
    "scene": "three_tendon",
    "effects.gravity.acceleration": [0.0, 0.0, -9.81],
    "effects.tip_load.mass": 0.005,
}
EXPLICIT = {
    "type": "explicit",
    "modes": [{"strains": ["bend_y", "bend_z"], "order": 1, "span": "rod"}],
}
CASES = {
    "nominal": {},
    "late": {
        "randomize": {
            "latency": [0.005, 0.03],
            "tension_gain": [0.9, 1.1],
            "noise": {"position": 1e-3, "rotation": 0.01},
        }
    },
    "drawn": {
        "randomize": {"stiffness": [0.8, 1.2], "damping": [0.5, 1.5], "payload": [0.0, 0.005]}
    },
    "loaded": {"scene": LOADED},
    "lag": {
        "scene": {
            "scene": "three_tendon",
            "effects.actuators": {"time_constant": 0.03, "delay": 0.01},
        }
    },
    "stiffer": {
        "scene": "catheter",
        "randomize": {"stiffness": 4.0},
        "observation": ["tip_position", "target_error", "command"],
    },
    "shape": {"task": "Shape"},
    "shape of a loaded arm": {"task": "Shape", "scene": LOADED},
    "shape of an explicit strain": {
        "task": "Shape",
        "scene": {"scene": "three_tendon", "strain": EXPLICIT},
        "fidelity": None,
    },
}
COSINES = {
    "stiffer": 0.99,
    "loaded": 0.999,
    "shape of a loaded arm": 0.999,
}  # under gravity the map backward is further off


@pytest.mark.parametrize("action", ["tension", "increment"])
def test_gradients_of_commands_that_a_rate_cuts_off_go_on_from_those_before(action):
    """The second command is asked for within the rate, the first beyond it; it moves with the one
    before where it is an increment, or cut off, and then alone."""
    env = rows_of("TipPose", rows=1, action=action, tension_rate=50.0, rate_limit=20.0)
    env.reset(seed=0)
    actuation = TensorActuation(episodes_of(env).actuation)
    first = torch.full((1, 3), 0.9, dtype=torch.float64)
    actuation.apply(first)
    np.testing.assert_allclose(actuation.command.numpy(), 0.4)
    before = actuation.command.clone().requires_grad_()
    for asked, is_cut in ((0.6, False), (3.0, True)):
        actuation.command = before
        if action == "increment":
            value = (asked - 0.4) / 1.0
        else:
            value = 2.0 * asked / 5.0 - 1.0
        action_now = torch.full((1, 3), value, dtype=torch.float64, requires_grad=True)
        actuation.apply(action_now)
        # a cost that falls with larger commands: descent would lead further beyond the rate
        by_action, by_before = torch.autograd.grad(-actuation.command.sum(), [action_now, before])
        follows = is_cut or action == "increment"
        np.testing.assert_allclose(by_before.numpy(), -1.0 if follows else 0.0)
        unit = 1.0 if action == "increment" else 2.5
        np.testing.assert_allclose(by_action.numpy(), 0.0 if is_cut else -unit)


@pytest.mark.parametrize("case", CASES)
@pytest.mark.parametrize("periods", [4, pytest.param(16, marks=pytest.mark.slow)])
def test_gradients_of_a_rollout_are_differences_of_rollouts(case, periods):
    """A cost of errors, actions and, of tips, their speed along eight random directions of the
    policy's parameters: commands stay within limits."""
    env = rows_of(**{"task": "TipPose", "rows": 4, **TENSE, **CASES[case]})
    torch.manual_seed(0)
    policy = torch.nn.Linear(
        env.reset(seed=0)[0].shape[1], env.single_action_space.shape[0], dtype=torch.float64
    )
    at = torch.nn.utils.parameters_to_vector(policy.parameters()).detach().mul_(0.1)

    def cost(parameters):
        torch.nn.utils.vector_to_parameters(parameters, policy.parameters())
        env.reset(seed=0)
        found = rollout(env, policy, periods, torch.float64)
        assert found.action.abs().max() < 0.9
        of_shape = found.backbone_error.shape[2] > 0
        tracked = (
            100.0 * (found.backbone_error if of_shape else found.error).square().sum()
            + found.action_change.square().sum()
        )
        if of_shape:
            return tracked
        return tracked + 0.1 * found.tip_twist.square().sum()

    cost(at).backward()
    gradient = torch.cat([parameter.grad.flatten() for parameter in policy.parameters()])
    directions = torch.randn(8, at.numel(), dtype=torch.float64)
    h = 1e-3
    with torch.no_grad():
        slopes = torch.stack(
            [(cost(at + h * way) - cost(at - h * way)) / (2.0 * h) for way in directions]
        )
    assert torch.cosine_similarity(directions @ gradient, slopes, dim=0) > COSINES.get(case, 0.9999)


def test_a_step_that_fails_passes_no_gradient():
    wild = {
        "scene": {"scene": "three_tendon", "integrator.max_halvings": 0},
        "fidelity": None,
        "tension_limits": [-600.0, 600.0],
    }
    env = rows_of("TipPose", rows=4, control_period=0.05, action="tension", **wild)
    env.reset(seed=0)
    actions = (
        torch.tensor([[1.0], [0.01], [-0.01], [-1.0]], dtype=torch.float64)
        .expand(4, 3)
        .clone()
        .requires_grad_()
    )
    found = rollout(env, lambda observation: actions, 1)
    found.error.square().sum().backward()
    failed = found.diverged[0]
    assert failed.tolist() == [True, False, False, True]
    assert torch.isfinite(actions.grad).all()
    assert not actions.grad[failed].any()
    assert actions.grad[~failed].any(dim=1).all()


def test_effects_whose_states_follow_the_motion_are_refused_backward():
    memory = {"branches": [{"modulus": 0.5, "relaxation_time": 0.1}]}
    env = rows_of("TipPose", scene={"scene": "three_tendon", "effects.viscoelastic_memory": memory})
    env.reset(seed=0)
    action = torch.zeros(3, 3, requires_grad=True)
    with pytest.raises(ValueError, match="effects.viscoelastic_memory has internal states"):
        rollout(env, lambda observation: action, 1).error.sum().backward()


def assert_refused(env, match, kind, policy=lambda observation: torch.zeros(3, 3), **arguments):
    with pytest.raises(kind, match=match):
        rollout(env, policy, **{"periods": 2, **arguments})


@pytest.mark.parametrize(
    ("values", "message"),
    [
        (lambda seen: np.sin(seen.tip_pose[:, :3, 3]), "'own' uses NumPy: gradients"),
        (lambda seen: np.ones((3, 3)), "'own' gives ndarray, no tensor"),
        (lambda seen: seen.tip_pose[:, 0, :3] / seen.arms.period, "'own' reads what tensors lack"),
    ],
)
def test_a_group_that_tensors_cannot_give_is_refused_for_gradients_alone(
    forgotten, values, message
):
    register("observation_group", "own", Group("one of a user's own", values))
    env = rows_of("TipPose", observation=["tip_position", "own"])
    observation, _ = env.reset(seed=0)
    assert observation.shape == (3, 6)
    with pytest.raises(ValueError, match=f"the observation group {message}"):
        rollout(env, lambda observation: torch.zeros(3, 3), 1)


def test_mistakes_are_said():
    env = rows_of("TipPose")
    assert_refused(env, "before reset", ResetNeeded)
    env.reset(seed=0)
    assert_refused(
        env, "periods should be a whole number of at least 1, not 0", ValueError, periods=0
    )
    assert_refused(
        env,
        r"the policy's action should have shape \(3, 3\), not \(3, 2\)",
        ValueError,
        lambda observation: torch.zeros(3, 2),
    )
    assert_refused(
        env,
        r"the policy's action should be finite",
        ValueError,
        lambda observation: torch.full((3, 3), torch.nan),
    )
    assert_refused(
        env,
        "policy should return a tensor of actions, not ndarray",
        TypeError,
        lambda observation: np.zeros((3, 3)),
    )
    assert_refused(gym.make("CartPole-v1"), "an environment of soft_tendon_env", TypeError)


ELASTIC = {"stiffness": 2e3, "displacement_limits": [0.0, 0.01]}
ACCURACY = [  # arm, changes, shares of the range that commands change by in a period; least cosine
    ("paper", {}, 0.05, 0.995),
    ("four_tendon", {}, 0.1, 0.999),
    ("catheter", {}, 0.1, 0.99),
    ("catheter", {"effects.gravity.acceleration": [0.0, 0.0, -9.81]}, 0.05, 0.99),
    ("underwater", {}, 0.05, 0.99),
    ("catheter", {"effects.actuators": {"delay": 0.033, "time_constant": 0.02}}, 0.05, 0.99),
    ("three_tendon", {"effects.tendon_friction": {"coefficient": 0.2}}, 0.05, 0.99),
    ("helical", {"effects.tendon_friction": {"coefficient": 0.7}}, 0.05, 0.98),
    ("three_tendon", {"effects.tendon_elasticity": ELASTIC}, 0.05, 0.98),
    (
        "underwater",
        {"effects.tendon_elasticity": {**ELASTIC, "displacement_limits": [0.0, 0.012]}},
        0.05,
        0.92,
    ),
]


@pytest.mark.parametrize(("name", "changes", "share", "least"), ACCURACY)
def test_gradients_of_every_kind_of_arm_are_those_of_differences(name, changes, share, least):
    """Cosines, and lengths within 15 %: a period is long beside a stiff wire's vibration, and
    elastic tendons go slack and taut."""
    scene = load_scene(name).replace(changes)
    model = build_model(scene, "fast")
    low, high = model.scene.effects.command_limits(
        np.array([tendon.tension_limits for tendon in model.scene.tendons])
    ).T
    found = gradient_accuracy(model, 0.02, low, high, share * (high - low), seed=1)
    assert found.cosine > least, found
    assert 0.85 < found.ratio < 1.15, found


HANGING = {"scene": "paper", "effects.gravity.acceleration": [0.0, 0.0, -9.81]}


@pytest.mark.parametrize(
    ("scene", "randomize", "told"),
    [
        ("catheter", {}, None),
        pytest.param(
            HANGING, {"payload": [0.0, 0.05]}, r"cosine of 0\.9[4-7]", marks=pytest.mark.slow
        ),
        (
            {
                "scene": "three_tendon",
                "effects.tendon_elasticity": {**ELASTIC, "displacement_limits": [-0.005, 0.01]},
            },
            {},
            r"cosine of 0\.9",
        ),
    ],
)
def test_a_training_is_told_of_gradients_that_are_far_off(scene, randomize, told):
    """By the worst of the first arms as they were drawn."""
    env = rows_of("TipPose", 4, scene=scene, randomize=randomize)
    env.reset(seed=0)
    with pytest.warns(GradientWarning, match=told) if told else nullcontext():
        check_gradients(episodes_of(env))


def slopes(value, pose, h=1e-6):
    """Central differences (6,) of value(pose) along body twists."""
    return np.array(
        [
            (value(moved_pose(pose, h * axis)) - value(moved_pose(pose, -h * axis))) / (2.0 * h)
            for axis in np.eye(6)
        ]
    )


@pytest.mark.parametrize(
    "angle", [(0.0,), (1e-9,), (1e-4,), (0.3,), (2.0,), (3.1,), (np.pi - 1e-4,)]
)
def test_gradients_of_the_logarithm_are_differences_along_body_twists(angle):
    rng = np.random.default_rng(0)
    axis = rng.normal(size=3)
    weight = rng.normal(size=6)
    pose = moved_pose(np.eye(4), rng.normal(size=6))
    wanted = moved_pose(
        pose, np.concatenate([angle * axis / np.linalg.norm(axis), rng.normal(size=3)])
    )
    g = torch.tensor(pose[None], requires_grad=True)
    g_bar = torch.tensor(wanted[None, None], requires_grad=True)
    error = pose_logarithm(g, g_bar)
    np.testing.assert_array_equal(error.detach()[0, 0], pose_error(pose, wanted))
    (error[0, 0] @ torch.tensor(weight)).backward()
    by_pose = slopes(lambda moved: weight @ pose_error(moved, wanted), pose)
    by_wanted = slopes(lambda moved: weight @ pose_error(pose, moved), wanted)
    np.testing.assert_allclose(body_cotangent(g.detach(), g.grad)[0], by_pose, atol=1e-7)
    np.testing.assert_allclose(
        body_cotangent(g_bar.detach(), g_bar.grad)[0, 0], by_wanted, atol=1e-7
    )


def test_a_clip_has_gradients_that_lead_back_inside():
    values = torch.tensor([-2.0, -2.0, 0.3, 0.3, 2.0, 2.0], dtype=torch.float64, requires_grad=True)
    clipped = inward_clip(values, -1.0, 1.0)
    assert clipped.tolist() == [-1.0, -1.0, 0.3, 0.3, 1.0, 1.0]
    clipped.backward(torch.tensor([1.0, -1.0, 1.0, -1.0, 1.0, -1.0]))  # descent goes against it
    assert values.grad.tolist() == [0.0, -1.0, 1.0, -1.0, 1.0, 0.0]
