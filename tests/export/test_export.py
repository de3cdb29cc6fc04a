"""Exported agents act as their originals, whatever they observe and however they are built; what cannot be exported is refused."""

import gymnasium as gym
import numpy as np
import pytest

pytest.importorskip("onnx")
pytest.importorskip("onnxruntime")
pytest.importorskip("torch")

import onnxruntime

from soft_tendon_env import export
from soft_tendon_env.envs import IDS
from soft_tendon_env.envs.tasks import TASKS
from soft_tendon_env.export.check import Agent, compare, record
from soft_tendon_env.export.graph import Graph
from soft_tendon_env.export.pose_errors import pose_errors
from soft_tendon_env.mechanics.motion import pose_errors as kernels
from soft_tendon_env.policies import load_agent, policy_options

MEASURABLE = {"observation": "measurable", "sensors": 2}
INCREMENTS = {**MEASURABLE, "action": "increment", "history": 2, "randomize": {"noise": {"position": 1e-3, "rotation": 0.01}}}
ELASTIC = {"scene": "three_tendon", "effects.tendon_elasticity": {"stiffness": 5e3, "displacement_limits": [0.0, 0.02]}}
SINGLE = 1e-5
"""Share of a largest action that round-off in single precision is below, where entries of an observation are up to 20."""
CASES = [
    {},
    {"policy": {"use_sde": True}, "normalised": True, **MEASURABLE},
    {"algorithm": "SAC", "policy": {"use_sde": True}, **INCREMENTS},
    {"algorithm": "TD3", "policy": {"activation_fn": "LeakyReLU"}, "integral_time": 0.3, **INCREMENTS},
    {"algorithm": "CrossQ", "task": "Shape", "integral_time": 0.3, **INCREMENTS},
    {"algorithm": "TQC", "task": "Shape", "integral_time": 0.3, "history": 1},
    {"algorithm": "SAC", "task": "Reach", "normalised": True, "integral_time": 0.3, **INCREMENTS},
    {"algorithm": "ARS", "observation": ["tip_position", "strain_rate", "last_action"], "sensors": 1},
    {"task": "Shape", "observation": ["tendon_lengths", "target_lengths", "command"], "scene": ELASTIC, "action": "increment"},
]


@pytest.mark.parametrize("given", CASES, ids=lambda given: f"{given.get('algorithm', 'PPO')}-{given.get('task', 'TipPose')}")
def test_commands_are_those_of_the_original(exported, given):
    env, agent, path = exported(**given)
    recorded = record(agent, env, seeds=(0, 1), steps=10)
    assert len(recorded) == 20 and np.ptp([period.command for period in recorded], axis=0).max() > 0.0
    assert compare(Agent(path), recorded).of_action < SINGLE


@pytest.mark.parametrize("task", sorted(TASKS.keys() & {"TipPose", "Shape", "Reach"}))
def test_agents_that_ship(task, tmp_path):
    env = gym.make(IDS[task], **policy_options("agent", task, {}))
    agent, path = load_agent("agent", env), tmp_path / "agent.onnx"
    path.write_bytes(export.export_agent(agent, env).SerializeToString())
    recorded = record(agent, env, steps=15)
    assert compare(Agent(path), recorded).of_range < 1e-6


def test_another_policy_is_told_apart(exported):
    env, agent, path = exported()
    recorded = record(agent, env, seeds=(0,), steps=3)
    recorded[1] = recorded[1]._replace(command=recorded[1].command + 0.01)
    found = compare(Agent(path), recorded)
    assert found.command == pytest.approx(0.01, rel=1e-3) and found.of_action == pytest.approx(2.0 * found.of_range)


def test_it_remembers_until_it_is_reset(exported):
    _, _, path = exported(observation=["tip_position", "command"], action="increment")
    agent, measured = Agent(path), {"tip_pose": np.eye(4)}
    first, second = agent(**measured), agent(**measured)
    assert (agent.states["command"] == second).all() and not np.array_equal(first, second)
    agent.states["command"] = first  # what was really sent
    np.testing.assert_array_equal(agent(**measured), second)
    agent.reset()
    np.testing.assert_array_equal(agent(**measured), first)


def test_metadata_say_what_goes_in_and_comes_out(exported):
    env, _, path = exported(**INCREMENTS)
    episodes, said = env.unwrapped.episodes, Agent(path).metadata
    assert said["task"] == "TipPose" and said["control_period_s"] == 0.02 and said["of"] == "nobody"
    assert {name: of["size"] for name, of in said["observation"].items()}["history"] == 2 * episodes.layout.kept.size
    assert said["inputs"]["tip_pose"] == {
        "shape": [4, 4],
        "unit": "1, last column m",
        "description": "homogeneous transform of the tip, world frame",
    }
    assert said["command"] == {
        "unit": "N",
        "least": episodes.limits[:, 0].tolist(),
        "greatest": episodes.limits[:, 1].tolist(),
        "increment": [2.0] * 3,
        "start": episodes.start_command.tolist(),
    }
    assert len(said["scene_digest"]) == 64 and said["versions"]["soft_tendon_env"]


def rotations():
    """Rotation vectors (m, 3): none, tiny, of any size, and of nearly half a turn about all axes and their diagonals."""
    draw = np.random.default_rng(1)
    axes = [*np.eye(3), *-np.eye(3), [1.0, -1.0, 0.0], [0.0, 1.0, -1.0], [1.0, 1.0, 1.0], *draw.normal(size=(5, 3))]
    axes = axes / np.linalg.norm(axes, axis=1, keepdims=True)
    angles = [0.0, 1e-9, 1e-6, 1.1e-6, 1e-4, 0.01, 1.0, 3.0, np.pi - 1e-4]
    return np.array([angle * axis for axis in axes for angle in angles])


def test_pose_errors_are_those_of_the_package():
    twists = np.concatenate([rotations(), np.random.default_rng(2).normal(size=(len(rotations()), 3))], axis=1)
    pose, wanted, expected = np.empty((1, 4, 4)), np.empty((1, len(twists), 4, 4)), np.empty((1, len(twists), 6))
    kernels.move_poses(np.eye(4)[None], np.array([[[0.3, -0.5, 0.2, 0.1, 0.2, -0.3]]]), wanted[:, :1])
    pose[0] = wanted[0, 0]
    kernels.move_poses(pose, twists[None], wanted)
    kernels.pose_errors(pose, wanted, expected)
    graph = Graph()
    names = graph.input("pose", (4, 4), ""), graph.input("wanted", wanted.shape[1:], "")
    graph.output("error", pose_errors(graph, *names, len(twists)), (len(twists), 6), "")
    model = graph.model("errors", {"soft_tendon_env": "{}"})
    session = onnxruntime.InferenceSession(model.SerializeToString(), providers=["CPUExecutionProvider"])
    (error,) = session.run(["error"], {"pose": pose[0], "wanted": wanted[0]})
    np.testing.assert_allclose(error, expected[0], atol=1e-11)
    np.testing.assert_allclose(error, twists, atol=1e-9)


@pytest.mark.cases(
    "given, message",
    [
        ({"algorithm": "RecurrentPPO"}, "a recurrent network cannot be exported"),
        ({"policy": {"activation_fn": "GELU"}}, "a layer GELU cannot be exported: valid are Linear, ELU, "),
    ],
)
def test_networks_that_cannot_be_exported(exported, given, message):
    with pytest.raises(ValueError, match=message):
        exported(**given)


def test_policies_that_cannot_be_exported(exported):
    from soft_tendon_env.policies import make_policy

    env, _, _ = exported()
    with pytest.raises(ValueError, match="should be a trained agent, as load_agent gives it, not ControllerPolicy"):
        export.export_agent(make_policy("tracking", env), env)
