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
import matplotlib.pyplot as plt
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env
from PIL import Image

import soft_tendon_env as ste
from soft_tendon_env.effects import EFFECTS
from soft_tendon_env.identification import load_markers
from soft_tendon_env.scene.file import scene_names

pytestmark = pytest.mark.slow
EXAMPLES = Path(__file__).parent.parent / "examples"


def run(example, folder, *arguments):
    """What an example prints, run as a user would, elsewhere."""
    environment = {**os.environ, "SOFT_TENDON_ENV_QUIET": "1"}
    command = [sys.executable, EXAMPLES / example, *arguments]
    return subprocess.run(command, cwd=folder, env=environment, check=True, capture_output=True, text=True).stdout


def test_quick_start_comes_to_rest_and_moves(tmp_path):
    printed = run("quick_start.py", tmp_path).splitlines()
    assert len(printed) == 2
    assert all("the tip is at" in line or "it is at" in line for line in printed)


def test_own_robot_reaches_its_goal(tmp_path):
    assert "mm from the goal; 100 periods" in run("own_robot.py", tmp_path)


def test_paper_trajectory_prints_a_row_per_model_and_draws(tmp_path):
    printed = run("paper_trajectory.py", tmp_path, "--models", "paper", "paper_16dof", "--duration", "0.2", "--out", str(tmp_path))
    rows = {line.split()[0]: line.split() for line in printed.splitlines() if line.startswith("paper")}
    assert {name: int(row[1]) for name, row in rows.items()} == {"paper": 10, "paper_16dof": 16}
    for row in rows.values():
        own, full = float(row[5]), float(row[6])
        assert own < 0.1 and full < 0.3, "mm, within the first 0.2 s"
    assert is_picture(tmp_path / "paper_trajectory.png")


def test_circle_stays_near_it_and_leaves_a_recording(tmp_path):
    printed = run("circle.py", tmp_path, "--fidelity", "fast", "--seconds", "4", "--out", str(tmp_path))
    error = float(printed.split("position error ")[1].split()[0])
    assert error < 40.0, "mm: a circle of 250 mm, followed without feedback"
    assert (tmp_path / "circle.rrd").stat().st_size > 100_000


def test_tracking_writes_a_small_moving_picture_of_an_arm_on_its_target(tmp_path):
    printed = run("tracking.py", tmp_path, "--fidelity", "fast", "--out", "new/tracking.gif")
    assert float(printed.split("position error ")[1].split()[0]) < 0.2, "mm"
    with Image.open(tmp_path / "new" / "tracking.gif") as picture:
        assert picture.n_frames == 125 and picture.info["duration"] == 40 and picture.info["loop"] == 0
    assert (tmp_path / "new" / "tracking.gif").stat().st_size < 2e6


def numbers(text):
    return [float(number) for number in re.findall(r"(?<![\w.])-?\d+\.?\d*(?![\w.])", text)]


def test_an_optimal_throw_is_far_faster_than_a_pull(tmp_path):
    pulled, optimal = (numbers(line)[0] for line in run("throw.py", tmp_path).splitlines())
    assert optimal > 3.0 * pulled, "m/s"


def test_an_effect_of_a_users_own_slows_the_arm(tmp_path):
    """Through the simulation; that it is what it says is shown below."""
    free, dragged = (line.split("through ")[1] for line in run("own_effect.py", tmp_path).splitlines())
    assert numbers(dragged)[0] < 0.8 * numbers(free)[0]


def test_a_rubber_arm_gives_way_less_and_swings_less(tmp_path):
    ideal, stiffening, remembering, both = (numbers(line) for line in run("rubber_arm.py", tmp_path).splitlines())
    assert ideal[0] > stiffening[0] > both[0] and remembering[0] > both[0]
    assert remembering[1] < 0.7 * ideal[1]


def test_the_gallery_draws_every_effect(tmp_path):
    run("effects_gallery.py", tmp_path, "--out", "new/docs")
    assert is_picture(tmp_path / "new" / "docs" / "effects_gallery.png") and is_picture(tmp_path / "new" / "docs" / "actuation_gallery.png")
    panels = vars(load("effects_gallery"))
    own = {name for name, effect in EFFECTS.items() if effect.__module__.startswith("soft_tendon_env.")}
    assert {name for name in own if not any(panel.startswith(name) for panel in panels)} == set()


def test_the_gallery_of_scenes_has_every_one(tmp_path):
    run("scene_gallery.py", tmp_path, "--out", "scenes")
    assert all(is_picture(tmp_path / "scenes" / f"{name}.png") for name in scene_names())


def test_the_gallery_shows_where_an_arm_on_a_floor_begins_to_slide(tmp_path):
    """At mu N: the picture's curves, pull [mN] against place [mm], until they first slide."""
    gallery = load("effects_gallery")
    _, axes = plt.subplots()
    gallery.contact_friction(axes)
    smooth, rough = (line.get_xydata() for line in axes.get_lines())
    first = [pull[np.argmax(np.abs(place) > 2.0)] for pull, place in (smooth.T, rough.T)]
    assert first[0] < 2.0 and 50.0 <= first[1] < 53.0, "0.5 of 100 mN"
    plt.close()


def test_a_controller_of_a_users_own_reaches_the_goal(tmp_path):
    away, reached = (numbers(line)[-1] for line in run("own_controller.py", tmp_path).splitlines())
    assert away > 20.0 and reached < 2.0, "mm"


def test_an_estimator_of_a_users_own_tells_the_controller_enough(tmp_path):
    assert numbers(run("own_estimator.py", tmp_path))[0] < 1.0, "mm"


def test_a_target_of_a_users_own_is_followed(tmp_path):
    assert numbers(run("own_target.py", tmp_path))[0] < 1.0, "mm"


def test_a_task_of_a_users_own_has_single_and_vector_environments(tmp_path):
    single, rows = run("own_task.py", tmp_path).split("eight rows:")
    assert numbers(single)[0] == 9 + 9 + 3 + 6 + 12 + 3, "coordinates, rates, axis, error, previews, action"
    assert len(numbers(rows)) == 8 and all(0.0 < reward < 1.0 for reward in numbers(rows))


def test_a_metric_and_a_condition_of_a_users_own_are_in_the_table(tmp_path):
    said = run("own_metric.py", tmp_path)
    assert said.startswith("0.3 m\n") and " peak [N] " in said and "\n| stiffness-50% " in said


def test_a_reward_term_of_a_users_own_is_part_of_the_reward(tmp_path):
    reward, position, gentleness = numbers(run("own_reward.py", tmp_path))
    assert reward == pytest.approx((position + 0.5 * gentleness) / 1.5, abs=1e-3) and 0.0 < gentleness < 1.0


def test_an_algorithm_of_a_users_own_trains_and_its_agent_loads(tmp_path):
    steps, error, bonus = numbers(run("own_algorithm.py", tmp_path).splitlines()[-1])
    assert steps == 8192 and 0.0 < error < 200.0 and bonus < 0.01, "the bonus has fallen"
    saved = json.loads((tmp_path / "out" / "fading_ppo" / "best" / "config.json").read_text())
    assert saved["algorithm"] == "FadingPPO"


def test_a_scene_of_a_users_own_bends_to_the_side_that_is_pulled(tmp_path):
    rest, goal = run("own_scene.py", tmp_path).splitlines()
    x, y, z = numbers(rest)[-3:]
    assert 0.1 < x < 0.12 and y > 0.02 and z == 0.0 and numbers(goal)[0] > 0.0


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
    with pytest.raises(ValueError, match="the effect Drag has no potential energy"):
        model.energy(q, q_dot)


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


def test_a_policy_learns_to_follow_the_ball(tmp_path):
    before, after = (numbers(line)[0] for line in run("follow_ball.py", tmp_path, "--steps", "30_000").splitlines())
    assert before < 0.0 and after > 80.0


def is_picture(path):
    content = path.read_bytes()
    return content.startswith(b"\x89PNG") and len(content) > 20_000


def test_own_policy_plays_beside_a_controller(tmp_path):
    few = ["--settings", "nominal", "--regimes", "tip", "--episodes", "1", "--seconds", "1.5"]
    printed = run("own_policy.py", tmp_path, *few, "--workers", "1")
    assert re.search(r"\| own_policy:bend +\| [1-9]", printed) and "| filtered:tracking@fast " in printed


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
