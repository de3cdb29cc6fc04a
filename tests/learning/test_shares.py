"""Shares of an arm: what their units are, and that one file of a training fits every arm."""

import json

import numpy as np
import pytest
import tomli_w

import soft_tendon_env as ste
from soft_tendon_env.learning import train
from soft_tendon_env.learning.config import find_config, read_training
from soft_tendon_env.learning.purpose import PURPOSE, purpose
from soft_tendon_env.learning.shares import UNITS, arm_units, in_si_units
from soft_tendon_env.policies.agent import CONFIG, trained_folder
from soft_tendon_env.scene.file import scene_names
from soft_tendon_env.scene.scene import rod_length, scene_to_dict
from soft_tendon_env.tools.configuration import ConfigurationError

ALGORITHMS = ("apg", "ppo", "sac")
LAST_TRAINING = {
    "apg": "apg_tip_pose_smooth",
    "apg_filtered": "apg_tip_pose_filtered",
    "ppo": "ppo_tip_pose",
    "sac": "sac_tip_pose",
}
"""The last training of agents that ship, by their names."""
SIZES = {**dict.fromkeys(UNITS, 1.0), "length": 0.3, "pace": 2.0, "force": 0.0873}
AS_SCENE = "options.fidelity=scene"  # without a trial of the arm


def config(algorithm):
    return find_config(f"{algorithm}_tip_pose")


@pytest.mark.parametrize(("agent", "file"), LAST_TRAINING.items())
def test_the_papers_arm_has_the_numbers_of_the_agents_that_ship(agent, file):
    record = json.loads((trained_folder() / agent / "TipPose" / CONFIG).read_text())
    training = read_training(find_config(file)).model_dump(mode="json")
    assert training["options"] == {"control_period": 0.02, **record["options"]}
    for key in ("hyperparameters", "seconds"):
        assert training[key] == record[key]


@pytest.mark.parametrize(
    ("value", "expected"),
    [
        ("0.5 length", 0.15),
        ("-2 length/pace", -0.3),
        ("0.05 rad/length", pytest.approx(1.0 / 6.0)),
        ("1e-3 length", pytest.approx(3e-4)),
        ("0.81 force", 0.071),
        ({"of": [{"at": "1 length"}, 0.2]}, {"of": [{"at": 0.3}, 0.2]}),
        (["random", "3 m.toml", "tip_pose", True], ["random", "3 m.toml", "tip_pose", True]),
    ],
)
def test_shares_become_numbers_and_all_else_stays(value, expected):
    assert in_si_units(value, SIZES) == expected


def test_a_share_of_what_is_no_unit_is_refused_by_its_key():
    with pytest.raises(ConfigurationError, match=r"of\[1\] is '2 lenght'.*did you mean 'length'"):
        in_si_units({"of": [0.1, "2 lenght"]}, SIZES)


def test_force_and_gravity_bend_the_arm_by_a_radian_as_far_as_it_is_linear():
    scene = ste.load_scene("three_tendon")
    units = arm_units(scene, {})
    small = 0.01
    loads = {
        "effects.tip_load.force": [0.0, small * units["force"], 0.0],
        "effects.gravity.acceleration": [0.0, small * units["gravity"], 0.0],
    }
    for key, vector in loads.items():
        changes = {key: vector, "strain.include_loads": True}
        bent = scene.replace(changes)
        model = ste.build_model(bent, "scene")
        rest = ste.static_equilibrium(model, np.zeros(3))
        angle = np.arctan2(rest.tip_pose[1, 0], rest.tip_pose[0, 0])
        assert angle == pytest.approx(small, rel=0.01)


def test_a_stiff_arm_is_pushed_by_what_bends_it_while_nobody_can_react():
    scene = ste.load_scene("three_tendon")
    changes = {"segments.*.young_modulus": 100.0 * 5e5}
    stiffer = scene.replace(changes)
    before = arm_units(scene, {})
    after = arm_units(stiffer, {})
    # it swings twice as far as to its rest within a tenth of a second
    at_rest = 0.05
    expected_force = 100.0 * at_rest * before["force"]
    assert after["force"] == pytest.approx(expected_force)


def test_pace_is_a_second_or_half_a_period_of_a_slower_arm():
    scene = ste.load_scene("three_tendon")
    changes = {"segments.*.young_modulus": 0.04 * 5e5}
    slower = scene.replace(changes)
    before = arm_units(scene, {})
    after = arm_units(slower, {})
    assert before["pace"] == 1.0
    expected_speed = 0.2 * before["speed"]
    assert after["speed"] == pytest.approx(expected_speed)
    period = 2.0 * np.pi * after["length"] / after["speed"]
    assert after["pace"] == pytest.approx(0.5 * period, rel=0.05)
    heavy = slower.replace({"effects.tip_load.mass": after["mass"]})
    assert arm_units(heavy, {})["pace"] > 2.0 * after["pace"]
    assert arm_units(scene, {"tension_limits": [0.0, 7.0]})["tension"] == 7.0


@pytest.mark.parametrize("name", scene_names())
def test_every_scene_gets_a_training_of_its_size(name):
    scene = ste.load_scene(name)
    training = read_training(config("ppo"), [f"options.scene={name}", AS_SCENE])
    length = rod_length(scene)
    pushes = training.options["scene"]["effects.disturbance.loads"]
    assert [push["at"] for push in pushes] == [length, 0.5 * length, length]
    assert training.options["randomize"]["noise"]["position"] == pytest.approx(1e-3 * length)
    assert training.options["scene"]["scene"] == name
    assert training.added_effects == {}


def test_an_arm_keeps_its_own_effects_and_what_is_drawn_is_added_to_them(tmp_path):
    own = {
        "effects.gravity.acceleration": [0.0, 0.0, -9.81],
        "effects.disturbance.loads": [{"at": 0.1, "force": [0.0, 0.1, 0.0]}],
    }
    scene = ste.load_scene("three_tendon").replace({"name": "mine", **own})
    path = tmp_path / "mine.toml"
    path.write_text(tomli_w.dumps(scene_to_dict(scene)))
    training = read_training(config("sac"), [f"options.scene={path}", AS_SCENE])
    path.unlink()
    arm = training.options["scene"]
    assert arm["scene"] == scene_to_dict(scene), "whatever becomes of the file"
    assert "effects.gravity.acceleration" not in arm
    assert "effects.disturbance.loads" not in arm
    drawn = training.options["randomize"]["effects"]
    assert drawn["gravity.acceleration"] == [{"offset": [-1.6, 1.6]}] * 3
    assert drawn["actuators.time_constant"] == [0.001, 0.04]
    assert not any(key.startswith("disturbance") for key in drawn)
    words = purpose(training)
    assert "'mine', 0.3 long" in words
    assert "effects.gravity.acceleration.2: -1.6 to 1.6 more than its own" in words
    assert "latency: 0 to" in words
    assert "tension_offset" not in words, "it is not drawn"


def test_posture_counts_the_entries_up_to_a_group(table):
    policy = {"memory": 4, "posture": "tendon_lengths"}
    small = {"n_steps": 4, "policy_kwargs": policy}
    options = {**table["options"], "observation": ["tip_position", "tendon_lengths", "preview"]}
    changed = {**table, "algorithm": "APG", "hyperparameters": small, "options": options}
    training = type(read_training(config("ppo"))).parse(changed, "file")
    assert training.hyperparameters["policy_kwargs"]["posture"] == 3 + 3
    policy["posture"] = "strain"
    with pytest.raises(ConfigurationError, match="policy_kwargs.posture is 'strain': it should be"):
        type(training).parse(changed, "file")


TINY = {
    "name": "tiny",
    "segments": [
        {
            "length": 0.05,
            "young_modulus": 1e6,
            "poisson_ratio": 0.49,
            "density": 1080.0,
            "damping": 3e3,
            "radius": 0.003,
        }
    ],
    "tendons": [
        {"routing": {"type": "straight", "offset": [offset, 0.0]}, "tension_limits": [0.0, 2.0]}
        for offset in (0.002, -0.002)
    ],
}
"""An arm of 50 mm with two tendons."""

FIRST_STEPS = {
    "apg": ["arms=2", "hyperparameters.n_steps=4", "steps=16"],
    "ppo": ["arms=2", "hyperparameters.n_steps=4", "hyperparameters.batch_size=8", "steps=16"],
    "sac": ["arms=2", "hyperparameters.learning_starts=4", "steps=16"],
}


@pytest.mark.slow
@pytest.mark.parametrize("algorithm", ALGORITHMS)
@pytest.mark.parametrize("arm", ["tiny", "three_tendon", "underwater", "catheter"])
def test_first_steps_on_any_arm(tmp_path, algorithm, arm):
    if arm == "tiny":
        arm = tmp_path / "tiny.toml"
        arm.write_text(tomli_w.dumps(TINY))
    short = ["evaluation.every=16", "evaluation.episodes=1", "seconds=1.1"]
    changes = [f"options.scene={arm}", AS_SCENE, *short, *FIRST_STEPS[algorithm]]
    training = read_training(config(algorithm), changes)
    model = train.train(training, tmp_path / "run")
    assert all(np.isfinite(weights.detach()).all() for weights in model.policy.parameters())
    assert (tmp_path / "run" / PURPOSE).read_text() == purpose(training)
