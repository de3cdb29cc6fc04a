"""The examples run, say what they found, and draw it."""

import importlib.util
import json
import os
import re
import runpy
import subprocess
import sys
from pathlib import Path

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env

import soft_tendon_env as ste
from soft_tendon_env.identification import load_markers

pytestmark = pytest.mark.slow
EXAMPLES = Path(__file__).parent.parent / "examples"
FEW = "--settings nominal --difficulties easy --regimes tip --episodes 1 --seconds 1.5 --workers 1".split()


def run(example, folder, *arguments):
    """What an example prints, run as a user would, elsewhere."""
    environment = {**os.environ, "SOFT_TENDON_ENV_QUIET": "1"}
    command = [sys.executable, EXAMPLES / example, *arguments]
    return subprocess.run(command, cwd=folder, env=environment, check=True, capture_output=True, text=True).stdout


def numbers(text):
    return [float(number) for number in re.findall(r"(?<![\w.])-?\d+\.?\d*(?![\w.])", text)]


def last(text):
    """The last number of every line."""
    return [numbers(line)[-1] for line in text.splitlines()]


RUNS = [
    ("quick_start.py", (), lambda said: said.count("it is at") + said.count("the tip is at") == 2),
    ("own_robot.py", (), lambda said: "mm from the goal; 100 periods" in said),
    ("circle.py", ("--fidelity", "fast", "--seconds", "4", "--out", "."), lambda said: numbers(said.split("position error ")[1])[0] < 40.0),
    ("throw.py", (), lambda said: numbers(said.splitlines()[1])[0] > 3.0 * numbers(said)[0]),
    ("own_effect.py", (), lambda said: 0.8 * numbers(said.split("through ")[1])[0] > numbers(said.split("through ")[2])[0]),
    ("rubber_arm.py", (), lambda said: numbers(said.splitlines()[0])[0] > numbers(said.splitlines()[3])[0]),
    ("own_controller.py", (), lambda said: last(said)[0] > 20.0 and last(said)[1] < 2.0),
    ("own_estimator.py", (), lambda said: numbers(said)[0] < 1.0),
    ("own_target.py", (), lambda said: numbers(said)[0] < 1.0),
    ("own_task.py", (), lambda said: numbers(said)[0] == 9 + 9 + 3 + 6 + 12 + 3 and len(numbers(said.split("eight rows:")[1])) == 8),
    ("own_metric.py", (), lambda said: said.startswith("0.3 m\n") and " peak [N] " in said and "\n| stiffness-50% " in said),
    ("own_reward.py", (), lambda said: abs(numbers(said)[0] - (numbers(said)[1] + 0.5 * numbers(said)[2]) / 1.5) < 1e-3),
    ("own_algorithm.py", (), lambda said: numbers(said.splitlines()[-1])[0] == 8192 and numbers(said.splitlines()[-1])[2] < 0.01),
    ("own_scene.py", (), lambda said: 0.1 < numbers(said.splitlines()[0])[-3] < 0.12 and numbers(said.splitlines()[0])[-1] == 0.0),
    (
        "follow_ball.py",
        ("--steps", "30_000"),
        lambda said: numbers(said.splitlines()[0])[0] < 0.0 and numbers(said.splitlines()[1])[0] > 80.0,
    ),
    ("own_policy.py", FEW, lambda said: re.search(r"own_policy:bend \(other\) +\| [1-9]", said)),
    ("paper_trajectory.py", ("--models", "paper", "--duration", "0.2", "--out", "."), lambda said: "paper " in said),
    ("tracking.py", ("--fidelity", "fast", "--out", "tracking.gif"), lambda said: numbers(said.split("position error ")[1])[0] < 0.2),
    ("effects_gallery.py", ("--out", "."), lambda said: True),
    ("scene_gallery.py", ("--out", "."), lambda said: True),
]
LEFT = {"paper_trajectory.py", "tracking.py", "effects_gallery.py", "scene_gallery.py", "circle.py"}
"""Examples that draw, or record."""


@pytest.mark.parametrize("example, arguments, is_right", RUNS, ids=[own[0] for own in RUNS])
def test_examples_find_what_they_should(tmp_path, example, arguments, is_right):
    said = run(example, tmp_path, *arguments)
    assert is_right(said), said
    sizes = [path.stat().st_size for path in tmp_path.rglob("*") if path.suffix in (".png", ".gif", ".rrd")]
    assert example not in LEFT or (sizes and min(sizes) > 20_000)


def load(example):
    """The module of an example, as a program of a user's would import it."""
    spec = importlib.util.spec_from_file_location(example, EXAMPLES / f"{example}.py")
    module = sys.modules[example] = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def test_the_drag_of_the_example_is_in_proportion_to_the_momentum(forgotten):
    """F = -rate M q_dot, with the mass matrix M: all inertia is dragged alike."""
    load("own_effect")
    model = ste.build_model(ste.load_scene("three_tendon").replace({"effects.drag.rate": 3.0}))
    q, q_dot = np.array([1.0, -0.5, 2.0]), np.array([3.0, 10.0, -4.0])
    terms = model.terms(q, q_dot)
    np.testing.assert_allclose(terms.external_force, -3.0 * terms.mass @ q_dot, rtol=1e-10)


def test_the_task_and_the_target_of_the_examples_pass_gymnasiums_checks(forgotten):
    load("own_task"), load("own_target")
    check_env(gym.make("TendonRod-Point-v0", scene="three_tendon", target="figure_eight").unwrapped, skip_render_check=True)


NEAR = np.eye(4) + np.outer([1, 0, 0, 0], [0, 0, 0, 0.245])


def test_the_reward_of_the_ball_is_its_formula_of_what_is_observed(forgotten):
    example, target = load("follow_ball"), {"type": "hold", "pose": NEAR.tolist()}
    env = gym.make_vec(example.ID, num_envs=4, **{**example.OPTIONS, "target": target})
    observation, _ = env.reset(seed=3)
    assert observation.shape == (4, 16)
    rewards, generator = [], np.random.default_rng(0)
    for _ in range(30):
        observation, reward, *_ = env.step(generator.uniform(-1.0, 1.0, (4, 4)))
        tip, tip_velocity, _, ball, ball_velocity = np.split(observation * 0.25, [3, 6, 10, 13], axis=1)
        off = tip - ball
        distance = np.linalg.norm(off, axis=1)
        rate = (off * (tip_velocity - 0.1 * ball_velocity)).sum(axis=1) / distance
        wanted = 1.5 * (distance < 0.01) - distance / 0.2 - np.maximum(rate, 0.0) / 0.3
        rewards.append(example.their_return(reward, 1))
        np.testing.assert_allclose(rewards[-1], wanted, atol=2e-5)
    assert np.max(rewards) > 1.0, "within 10 mm"


def test_the_tentacle_is_identified_from_files_as_its_authors_publish_them(tmp_path):
    tentacle = runpy.run_path(str(EXAMPLES / "tentacle.py"))
    (tmp_path / "arm.toml").write_text(tentacle["SCENE"])
    (tmp_path / "markers.toml").write_text(tentacle["MARKERS"])
    scene = ste.load_scene(tmp_path / "arm.toml").replace({f"segments.{i}.young_modulus": 373e3 for i in range(2)})
    markers = load_markers(tmp_path / "markers.toml", scene)
    model, random = ste.build_model(scene, "fine"), np.random.default_rng(0)
    turn = np.array([[0.0, 0.0, 1.0], [0.0, 1.0, 0.0], [-1.0, 0.0, 0.0]])  # scene to z up
    for name in ("m1_u01", "m1_u025", "m2_u015", "m2_u025", "m1_u018", "m12_u0015002"):
        poses = model.backbone_at(
            ste.static_equilibrium(model, np.array(tentacle["TORQUES"][name]) / tentacle["PULLEY"]).q, markers.arc_lengths
        )
        inside = (poses[:, :3, 3] + np.einsum("mij,mj->mi", poses[:, :3, :3], markers.offsets)) @ turn.T
        points = np.vstack([tentacle["BASE"], inside])
        seen = np.column_stack([points[:, 0], -points[:, 2], points[:, 1]])[random.permutation(5)] + [0.2, 0.1, 0.2]  # y down, any order
        np.savetxt(tmp_path / f"{name}.csv", np.column_stack([range(3), range(3), np.tile(seen.ravel(), (3, 1))]), delimiter=",")
    printed = run("tentacle.py", tmp_path, str(tmp_path)).splitlines()
    assert printed[0] == "6 holds"
    assert all(max(float(own) for own in re.findall(r"([\d.]+) mm", line)) < 1.5 for line in printed[1:]), printed
    numbers = json.loads((tmp_path / "out" / "tentacle" / "E_and_density" / "estimate.json").read_text())
    assert numbers["parameters"]["segments.*.young_modulus"]["value"] == pytest.approx(373e3, rel=0.02)
