"""Conditions of evaluations: their numbers are those of their names and descriptions, loads are
where they say."""

import itertools

import numpy as np
import pytest

from soft_tendon_env import load_scene
from soft_tendon_env.envs import Options
from soft_tendon_env.evaluation.conditions import MODEL_ERRORS, SEEDS, SETTINGS, model_error
from soft_tendon_env.evaluation.settings import MOST_STEPS, Settings, episode_steps
from soft_tendon_env.policies.regimes import NOISE

DRAWN = {
    "nominal": {},
    "stiffness-20%": {"stiffness": 1 - 0.2},
    "stiffness+20%": {"stiffness": 1 + 0.2},
    "damping-halved": {"damping": 1 / 2},
    "damping-doubled": {"damping": 2.0},
    "payload-20g": {"payload": 20e-3},
    "tension-10%": {"tension_gain": 1 - 0.1},
    "tension+10%": {"tension_gain": 1 + 0.1},
    "latency-20ms": {"latency": 20e-3},
}
RANGES = {
    "model_errors": {
        "stiffness": (1 / 1.25, 1.2),
        "damping": (1 / 2, 2.0),
        "payload": (0.0, 20e-3),
        "tension_gain": (0.9, 1.1),
        "latency": (0.0, 20e-3),
    },
    "latency": {"latency": (0.0, 60e-3)},
    "actuation": {
        "effects": {
            "tendon_friction.coefficient": (0.0, 0.1),
            "actuators.time_constant": (5e-3, 40e-3),
        }
    },
    "water": {"effects": {"fluid.current": [(-0.2, 0.2)] * 3}},
}


@pytest.mark.parametrize("name", DRAWN)
def test_model_errors_are_what_their_names_say(name):
    drawn = MODEL_ERRORS[name].options({})["randomize"]
    assert drawn == pytest.approx(DRAWN[name])


def test_noise_is_that_of_sensors_and_of_their_rates():
    drawn = MODEL_ERRORS["noise"].options({})["randomize"]
    assert drawn == {"noise": {**NOISE, "curvature_rate": 0.5, "stretch_rate": 0.01}}
    assert {
        "position": 1e-3,
        "rotation": np.radians(0.5),
        "length": 5e-4,
        "curvature": 0.05,
        "stretch": 1e-3,
    } == NOISE


@pytest.mark.parametrize("name", RANGES)
def test_settings_draw_from_the_ranges_of_their_descriptions(name):
    assert SETTINGS[name].options({})["randomize"] == RANGES[name]


@pytest.mark.parametrize("name", SETTINGS)
def test_settings_are_options_of_an_environment(name):
    Options.parse(SETTINGS[name].options({"scene": "three_tendon"}), "options")


def test_conditions_change_the_given_scene_and_override_what_it_draws():
    given = {"scene": {"scene": "three_tendon", "quadrature.intervals": 4}, "preview": [0.1]}
    given["randomize"] = {"damping": 0.7, "latency": 0.5}
    options = SETTINGS["water"].options(given)
    assert options["scene"] == {**given["scene"], "effects.fluid.density": 1000.0}
    assert options["preview"] == [0.1]
    assert options["randomize"] == {**given["randomize"], **RANGES["water"]}
    assert SETTINGS["latency"].options(given)["randomize"]["latency"] == (0.0, 0.06)
    assert SETTINGS["latency"].options(given)["scene"] is given["scene"]
    assert SETTINGS["hard"].options({})["difficulty"] == "hard"


def test_loads_come_from_every_side_up_to_gravity():
    """In the corner of their box as much as gravity, in any direction more than half of it."""
    drawn = SETTINGS["load"].options({})["randomize"]
    ends = np.array(drawn["effects"]["gravity.acceleration"])
    np.testing.assert_array_equal(ends[:, 0], -ends[:, 1])
    assert np.linalg.norm(ends[:, 1]) == pytest.approx(9.81, abs=0.02)
    assert drawn["payload"] == (0.0, 50e-3)


def test_pushes_follow_one_another_at_the_tip_and_in_the_middle():
    options = SETTINGS["pushes"].options({"scene": "three_tendon"})
    loads = options["scene"]["effects.disturbance.loads"]
    assert [load["at"] for load in loads] == pytest.approx([0.3, 0.15, 0.3])
    signals = [load["signal"] for load in loads]
    assert [signal["start"] for signal in signals] == [1.5, 3.0, 4.5]
    assert [signal["duration"] for signal in signals] == [0.2, 0.4, 0.6]
    no_force = [0.0, 0.0, 0.0]  # until one is drawn
    assert all(load["force"] == no_force for load in loads)
    drawn = options["randomize"]["effects"]
    force_range = [(-0.5, 0.5)] * 3
    assert drawn == {f"disturbance.loads.{i}.force": force_range for i in range(3)}


@pytest.mark.parametrize("turned", [False, True])
def test_balls_swing_across_the_straight_arm_and_begin_beside_it(turned):
    """Through its axis at two fifths and three fifths of it, a quarter of its length to each side;
    with the phase of a quarter turn they begin at an end."""
    scene = "three_tendon"
    if turned:
        scene = {
            "scene": scene,
            "base.position": [1.0, 2.0, 3.0],
            "base.quaternion": [0.6, 0.0, 0.8, 0.0],
        }
    changes = SETTINGS["obstacles"].options({"scene": scene})["scene"]
    balls = changes["effects.contact"]["obstacles"]
    base = load_scene("three_tendon").base.pose
    if turned:
        base = load_scene("three_tendon").replace(dict([*scene.items()][1:])).base.pose
    for ball, place, axis in zip(balls, (0.4, 0.6), (1, 2), strict=True):
        middle = base[:3, 3] + place * 0.3 * base[:3, 0]
        np.testing.assert_allclose(ball["position"], middle, atol=1e-12)
        expected_amplitude = 0.25 * 0.3 * base[:3, axis]
        np.testing.assert_allclose(ball["amplitude"], expected_amplitude, atol=1e-12)
        assert ball["radius"] == pytest.approx(0.05 * 0.3)
        assert ball["phase"] == 90.0
    assert balls[0]["frequency"] != balls[1]["frequency"]
    drawn = SETTINGS["obstacles"].options({"scene": scene})["randomize"]["effects"]
    assert drawn == {f"contact.obstacles.{i}.phase": (60.0, 120.0) for i in range(2)}


def test_several_model_errors_hold_together_unless_they_speak_of_the_same():
    both = model_error("stiffness+20%,payload-20g").options({})["randomize"]
    assert both == {"stiffness": 1.2, "payload": 0.02}
    with pytest.raises(ValueError, match="in which stiffness is said twice"):
        model_error("stiffness+20%,stiffness-20%")
    with pytest.raises(ValueError, match="names 'gravity'"):
        model_error("payload-20g,gravity")


def test_no_seed_has_two_purposes():
    for first, second in itertools.combinations(SEEDS.values(), 2):
        assert first.stop <= second.start or second.stop <= first.start
    assert len(Settings().errors) == len(MODEL_ERRORS)
    assert Settings(errors=("all", "nominal")).errors == tuple(MODEL_ERRORS)
    with pytest.raises(ValueError, match="names 'gravity'"):
        Settings(errors=("nominal", "gravity"))


@pytest.mark.parametrize(
    ("seconds", "skip", "steps"), [(1.0, 1.0, 50), (0.02, 0.0, 1), (0.5, 0.1, 25)]
)
def test_an_episode_has_its_control_periods(seconds, skip, steps):
    assert episode_steps(seconds, skip, {}) == steps
    assert episode_steps(2.0 * seconds, skip, {"control_period": 0.04}) == steps


@pytest.mark.parametrize(
    ("seconds", "skip", "message"),
    [
        (0.009, 0.0, "at least one control period"),
        (1.0, 1.01, "at least one control period, 0.02 s, and skip, which is 1.01"),
        (1.1 * MOST_STEPS * 0.02, 0.0, "at most 1000000 control periods, 20000 s"),
    ],
)
def test_episodes_that_are_too_short_or_too_long_are_refused(seconds, skip, message):
    with pytest.raises(ValueError, match=message):
        episode_steps(seconds, skip, {})
