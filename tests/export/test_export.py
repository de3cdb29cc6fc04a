"""Exported agents act as their originals, whatever they observe and however they are built; what
cannot be exported is refused."""

import json
from pathlib import Path

import gymnasium as gym
import numpy as np
import pytest

onnxruntime = pytest.importorskip("onnxruntime")
torch = pytest.importorskip("torch")
pytest.importorskip("onnx")
pytest.importorskip("stable_baselines3")

from soft_tendon_env import register  # noqa: E402
from soft_tendon_env.envs import IDS  # noqa: E402
from soft_tendon_env.envs.observation import Group  # noqa: E402
from soft_tendon_env.export.agent import (  # noqa: E402
    _ExportedAgent,
    compare,
    export_agent,
    measurements,
    pose_logarithm,
)
from soft_tendon_env.learning.networks import new_network  # noqa: E402
from soft_tendon_env.mechanics.motion import pose_errors as kernels  # noqa: E402
from soft_tendon_env.policies import load_agent, make_policy, policy_options  # noqa: E402
from soft_tendon_env.policies.agent import NetworkPolicy  # noqa: E402
from soft_tendon_env.policies.algorithms import network_kind  # noqa: E402
from soft_tendon_env.policies.architecture import read_architecture  # noqa: E402
from soft_tendon_env.policies.integral import IntegralPolicy  # noqa: E402
from soft_tendon_env.policies.normalization import Moments, Normalization  # noqa: E402
from soft_tendon_env.policies.weights import acting_arrays, build_network  # noqa: E402

TRAINED = sorted(
    path.parent
    for path in (Path(__file__).parent.parent.parent / "agents" / "trained").glob("*/*/weights.npz")
)
MEASURABLE = {"observation": "measurable", "sensors": 2, "action": "tension"}
INCREMENTS = {
    **MEASURABLE,
    "action": "increment",
    "history": 2,
    "randomize": {"noise": {"position": 1e-3, "rotation": 0.01}},
}
ELASTIC = {
    "scene": "three_tendon",
    "effects.tendon_elasticity": {"stiffness": 5e3, "displacement_limits": [0.0, 0.02]},
}
CASES = [
    {},
    {"policy": {"use_sde": True}, "normalised": True, **MEASURABLE},
    {"algorithm": "SAC", "policy": {"use_sde": True, "activation_fn": "GELU"}, **INCREMENTS},
    {"policy": {"activation_fn": "LeakyReLU"}, "integral_time": 0.3, **INCREMENTS},
    {"algorithm": "CrossQ", "task": "Shape", "integral_time": 0.3, **INCREMENTS},
    {"algorithm": "TQC", "task": "Shape", "integral_time": 0.3, "history": 1},
    {"algorithm": "SAC", "task": "Reach", "normalised": True, "integral_time": 0.3, **INCREMENTS},
    {"observation": ["tip_position", "strain_rate", "last_action"], "sensors": 1},
    {"observation": ["target_pose", "pose_preview", "tip_rotation"], "history": 1},
    {
        "algorithm": "APG",
        "policy": {"memory": 8, "fine": 10.0, "posture": 9},
        "integral_time": 0.3,
        **MEASURABLE,
        "action": "increment",
    },
    {
        "task": "Shape",
        "observation": ["tendon_lengths", "target_lengths", "command"],
        "scene": ELASTIC,
        "action": "increment",
    },
]


@pytest.fixture
def exported(tmp_path):
    """exported(algorithm=..., task=..., ...): an environment, an agent of random weights for it,
    and the path of its file."""

    def make(
        algorithm="PPO",
        task="TipPose",
        policy=None,
        normalised=False,
        integral_time=None,
        **options,
    ):
        env = gym.make(IDS[task], **{"scene": "three_tendon", "fidelity": "fast", **options})
        torch.manual_seed(0)
        arguments = {"net_arch": [16, 16], **(policy or {})}
        trained = new_network(algorithm, arguments, env.observation_space, env.action_space)
        with torch.no_grad():
            for parameter in trained.parameters():
                parameter += 0.1 * torch.randn_like(parameter)
        network = build_network(
            read_architecture(network_kind(algorithm), arguments),
            acting_arrays(trained.state_dict()),
            env.observation_space,
            env.action_space,
        )
        if task == "Reach":
            spaces = env.observation_space.spaces
        else:
            spaces = {"": env.observation_space}
        draw = np.random.default_rng(0)
        moments = {
            key: Moments(draw.normal(size=of.shape), draw.uniform(0.1, 1.0, of.shape))
            for key, of in spaces.items()
        }
        agent = NetworkPolicy(network, Normalization(moments, 3.0, 1e-8) if normalised else None)
        if integral_time is not None:
            agent = IntegralPolicy(agent, env, integral_time)
        path = tmp_path / "agent.onnx"
        path.write_bytes(export_agent(agent, env, {"of": "nobody"}).SerializeToString())
        return env, agent, path

    return make


@pytest.mark.parametrize(
    "given",
    CASES,
    ids=lambda given: f"{given.get('algorithm', 'PPO')}-{given.get('task', 'TipPose')}",
)
def test_commands_are_those_of_the_original(exported, given):
    env, agent, path = exported(**given)
    observations, _, of_range = compare(path, agent, env, seeds=(0, 1), steps=10)
    assert observations == 20
    assert of_range < 1e-6


@pytest.mark.slow
@pytest.mark.parametrize(
    "folder", TRAINED, ids=lambda folder: f"{folder.parent.name}-{folder.name}"
)
def test_agents_that_ship(folder, tmp_path):
    env = gym.make(IDS[folder.name], **policy_options(folder.parent.name, folder.name, {}))
    agent = load_agent(folder.parent.name, env)
    path = tmp_path / "agent.onnx"
    path.write_bytes(export_agent(agent, env).SerializeToString())
    assert compare(path, agent, env, steps=15)[2] < 3e-6


def test_another_policy_is_told_apart(exported):
    env, agent, path = exported(action="tension")
    agent.network.actor.head.layers[0].bias[:] += 0.01
    _, difference, of_range = compare(path, agent, env, seeds=(0,), steps=3)
    assert of_range == pytest.approx(0.005, rel=1e-3)
    expected_difference = of_range * np.ptp(env.unwrapped.episodes.limits[0])
    assert difference == pytest.approx(expected_difference)


def test_it_remembers_and_says_what_goes_in(exported):
    env, _, path = exported(observation=["tip_position", "command"], action="increment")
    session = onnxruntime.InferenceSession(str(path), providers=["CPUExecutionProvider"])
    names = [of.name for of in session.get_outputs()]
    given = {"tip_pose": np.eye(4), "started": np.zeros(1), "command": np.zeros(3)}
    first = dict(zip(names, session.run(None, given), strict=True))
    second = dict(
        zip(
            names,
            session.run(None, {**given, "started": np.ones(1), "command": first["next_command"]}),
            strict=True,
        )
    )
    assert first["next_started"] == 1.0
    assert not np.array_equal(first["next_command"], second["next_command"])
    said = json.loads(session.get_modelmeta().custom_metadata_map["soft_tendon_env"])
    limits = env.unwrapped.episodes.limits
    assert (said["task"], said["control_period_s"], said["of"]) == ("TipPose", 0.02, "nobody")
    assert said["inputs"] == {"tip_pose": {"shape": [4, 4], "unit": "1, last column m"}}
    assert said["command"] == {"unit": "N", "limits": limits.tolist()}


def test_pose_logarithms_are_those_of_the_package():
    """Of no rotation, tiny ones, any, and nearly half a turn, about all axes and their
    diagonals."""
    draw = np.random.default_rng(1)
    axes = np.array(
        [
            *np.eye(3),
            *-np.eye(3),
            [1.0, -1.0, 0.0],
            [0.0, 1.0, -1.0],
            [1.0, 1.0, 1.0],
            *draw.normal(size=(5, 3)),
        ]
    )
    axes /= np.linalg.norm(axes, axis=1, keepdims=True)
    rotations = np.array(
        [
            angle * axis
            for axis in axes
            for angle in (0.0, 1e-9, 1e-6, 1.1e-6, 1e-4, 0.01, 1.0, 3.0, np.pi - 1e-4)
        ]
    )
    twists = np.concatenate([rotations, draw.normal(size=rotations.shape)], axis=1)
    pose = np.empty((1, 4, 4))
    wanted = np.empty((1, len(twists), 4, 4))
    kernels.move_poses(
        np.eye(4)[None], np.array([[[0.3, -0.5, 0.2, 0.1, 0.2, -0.3]]]), wanted[:, :1]
    )
    pose[0] = wanted[0, 0]
    kernels.move_poses(pose, twists[None], wanted)
    np.testing.assert_allclose(
        pose_logarithm(torch.tensor(pose[0]), torch.tensor(wanted[0])), twists, atol=1e-9
    )
    half = torch.diag(torch.tensor([1.0, -1.0, -1.0, 1.0], dtype=torch.float64))[None]
    turned = pose_logarithm(torch.eye(4, dtype=torch.float64), half)[0].abs()
    np.testing.assert_allclose(turned, [np.pi, 0.0, 0.0, 0.0, 0.0, 0.0], atol=1e-12)


def test_what_cannot_be_exported(exported, forgotten):
    own = Group("made by NumPy", lambda o: np.sin(o.tip_pose[:, :3, 3]))
    register("observation_group", "own", own)
    with pytest.raises(
        ValueError, match="the observation group 'own' uses NumPy: gradients and ONNX"
    ):
        exported(observation=["tip_position", "own"])
    env = gym.make(IDS["TipPose"], scene="three_tendon", fidelity="fast")
    with pytest.raises(ValueError, match="as load_agent gives it, not ControllerPolicy"):
        export_agent(make_policy("tracking", env), env)


@pytest.mark.parametrize("bad", [np.nan, pytest.param(np.inf, marks=pytest.mark.slow)])
def test_a_lost_measurement_holds_the_command_and_the_memory(exported, bad):
    """NaN of a tracker that has lost sight reaches neither the motors nor what is remembered."""
    policy = {"memory": 8, "fine": 10.0, "posture": 9}
    env, _, path = exported("APG", policy=policy, integral_time=0.3, **INCREMENTS)
    agent = _ExportedAgent(path)
    env.reset(seed=0)
    first = agent.start()
    lost = measurements(env.unwrapped.episodes)
    seen = {name: value.copy() for name, value in lost.items()}
    lost["tip_pose"][1, 3] = bad
    # before anything was measured: the command at rest, and the episode has not begun
    held = agent.act(first, lost)
    np.testing.assert_array_equal(held["next_command"], env.unwrapped.episodes.start_command)
    assert not held["next_started"].any()
    after = agent.act(first, seen)
    np.testing.assert_array_equal(agent.act(held, seen)["next_command"], after["next_command"])
    assert after["next_started"] == 1.0
    for name in ("tip_pose", "strain", "target_twist"):
        lost = {key: value.copy() for key, value in seen.items()}
        lost[name].flat[1] = bad
        held = agent.act(after, lost)
        np.testing.assert_array_equal(held["action"], after["next_last_action"])
        for key in after:
            if key.startswith("next_"):
                np.testing.assert_array_equal(held[key], after[key])
    # an agent that does not read its last action holds the command all the same
    for kind, action in (("increment", 0.0), ("tension", 2.0 * np.array([0.4, 0.1, 0.5]) - 1.0)):
        env, _, path = exported(observation=["tip_position", "command"], action=kind)
        agent = _ExportedAgent(path)
        before = {"next_started": np.ones(1), "next_command": np.array([2.0, 0.5, 2.5])}
        held = agent.act(before, {"tip_pose": np.full((4, 4), bad)})
        np.testing.assert_allclose(held["action"], action, atol=1e-12)
        np.testing.assert_allclose(held["next_command"], before["next_command"], atol=1e-12)


def test_what_an_exported_agent_does_not_read_may_be_lost(exported):
    env, _, path = exported("APG", policy={"memory": 8}, **INCREMENTS)
    agent = _ExportedAgent(path)
    env.reset(seed=0)
    seen = measurements(env.unwrapped.episodes)
    after = agent.act(agent.start(), seen)
    # what the agent does not read may be anything
    unread = {**seen, "tip_twist": np.full(6, np.nan)}
    np.testing.assert_array_equal(
        agent.act(after, unread)["action"], agent.act(after, seen)["action"]
    )
