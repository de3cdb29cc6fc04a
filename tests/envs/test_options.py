"""What is no option and no action is refused by name, before anything changes."""

from pathlib import Path

import gymnasium as gym
import numpy as np
import pytest

from soft_tendon_env import load_scene
from soft_tendon_env.accuracy.fidelity import at_fidelity
from soft_tendon_env.envs import IDS, Options, ReachEnv, ShapeEnv, TipPoseEnv
from soft_tendon_env.envs.options import resolved_scene
from soft_tendon_env.envs.randomization import Randomization
from soft_tendon_env.envs.targets.shipped import Hold
from soft_tendon_env.scene.file import SHIPPED
from soft_tendon_env.scene.scene import extrapolation_columns, scene_to_dict
from soft_tendon_env.tools.configuration import ConfigurationError

SMALL = {"scene": "three_tendon", "fidelity": "fast"}
BAD = [
    (
        TipPoseEnv,
        {"scen": "paper"},
        r"scen is an unknown key \(given 'paper'\): did you mean 'scene'\?",
    ),
    (TipPoseEnv, {"scene": "papr"}, "'papr': is neither .* did you mean 'paper'"),
    (
        TipPoseEnv,
        {"scene": 5},
        "scene is 5: it should be the name of a shipped scene, the path .*, a Scene, or a table",
    ),
    (
        TipPoseEnv,
        {"scene": {"segments.0.young_modulu": 1.0}},
        r"segments\[0\]\.young_modulu is an unknown key",
    ),
    (
        TipPoseEnv,
        {"fidelity": "coarse"},
        "fidelity is 'coarse': it should be 'fast', 'standard', 'fine', 'scene' or a length",
    ),
    (
        TipPoseEnv,
        {"control_period": 0.0},
        "control_period is 0.0: it should be greater than or equal to 0.000001",
    ),
    (
        TipPoseEnv,
        {"tension_limits": [3.0, 1.0]},
        r"tension_limits is \[3.0, 1.0\]: it should be \(least, greatest\)",
    ),
    (
        TipPoseEnv,
        {"tension_limits": [1000.0, 1500.0]},
        r"scene has an arm that cannot begin at rest, under \[1000, 1000, 1000\] N",
    ),
    (TipPoseEnv, {"action": "torque"}, "action is 'torque': it should be 'increment' or 'tension'"),
    (
        TipPoseEnv,
        {"target": "circel"},
        (
            r"target\.type is 'circel': did you mean 'circle'\? valid: circle, circles, either,"
            r" file, hold, out_of_reach, ramp"
        ),
    ),
    (TipPoseEnv, {"target": 3}, "target is 3"),
    (
        TipPoseEnv,
        {"target": {"type": "random", "knot_period": 20.0}},
        r"target\.knot_period is 20: it should be 0.001 to 2.5 s",
    ),
    (
        TipPoseEnv,
        {"target": {"type": "random", "fraction": [0.5, 0.2]}},
        r"target\.fraction is \[0\.5, 0\.2\]: it should be a number",
    ),
    (
        TipPoseEnv,
        {"target": {"type": "hold", "tension": [1.0]}},
        r"target\.tension has 1 entries: it should have one per tendon, 3",
    ),
    (
        TipPoseEnv,
        {"target": {"type": "hold", "tension": [1.0] * 3, "pose": np.eye(4)}},
        "tension or pose, not both",
    ),
    (TipPoseEnv, {"target": {"type": "hold", "pose": 2 * np.eye(4)}}, "homogeneous matrix"),
    (
        TipPoseEnv,
        {"observation": "everything"},
        "observation is 'everything': .*valid: full, measurable, or a list of groups",
    ),
    (
        TipPoseEnv,
        {"observation": ["rates", "rate"]},
        "observation names 'rate': did you mean 'rates'",
    ),
    (TipPoseEnv, {"observation": ["target_coordinates"]}, "observation names 'target_coordinates'"),
    (TipPoseEnv, {"observation": ["rates", "rates"]}, "each once"),
    (
        TipPoseEnv,
        {"preview": [0.1, 0.0099]},
        (
            r"preview\[1\] is 0.0099: it should be more than half a control period, 0.01 s, and at"
            r" most 1"
        ),
    ),
    (TipPoseEnv, {"sensors": [-0.1]}, r"sensors\[0\] is -0.1"),
    (TipPoseEnv, {"sensors": 0}, "sensors is 0: it should be greater than or equal to 1"),
    (
        TipPoseEnv,
        {"sensors": [0.4]},
        "sensors names 0.4: it should be at most the rod's length, 0.3",
    ),
    (
        TipPoseEnv,
        {"reward": {"positon": 1.0}},
        r"reward\.positon is no term of this environment: did you mean 'position'",
    ),
    (
        TipPoseEnv,
        {"reward": {"position": {"wight": 1.0}}},
        r"reward\.position\.wight is an unknown key .* did you mean 'weight'",
    ),
    (
        TipPoseEnv,
        {"reward": {"position": {"scale": [0.1, -1.0]}}},
        r"reward\.position\.scale\[1\] is -1.0",
    ),
    (
        TipPoseEnv,
        {"reward": {"position": 0.0}},
        "reward should give at least one term a weight above 0",
    ),
    (
        TipPoseEnv,
        {"reward": "sparse"},
        "reward is 'sparse', which tasks with a goal have, such as Reach: TipPose takes a table",
    ),
    (ShapeEnv, {"reward": "dense"}, "reward is 'dense', .* such as {'graded_backbone': 1.0"),
    (TipPoseEnv, {"preview": 0.1}, r"preview is 0.1: it should be a list of times .*: \[0.1\]"),
    (TipPoseEnv, {"preview": 2}, r"preview is 2: it should be a list of times ahead .*: \[2\]"),
    (TipPoseEnv, {"threshold": 1e-300}, "threshold is 1e-300"),
    (TipPoseEnv, {"threshold": 0.01}, "threshold is 0.01, which tasks with a goal have"),
    (
        TipPoseEnv,
        {"history": 2, "observation": ["target_error"]},
        "history is 2, and the observation has no group that describes the arm",
    ),
    (
        TipPoseEnv,
        {"target": {"type": "hold", "tension": [1.0] * 3, "fraction": 0.5}},
        r"target\.fraction is 0\.5, and nothing is drawn: leave it out",
    ),
    (
        ReachEnv,
        {"target": {"type": "hold", "position": [0.2, 0.1, 0.0], "fraction": [0.1, 0.2]}},
        r"target\.fraction is \[0\.1, 0\.2\], and nothing is drawn",
    ),
    (TipPoseEnv, {"rate_limit": 0.0}, "rate_limit is 0.0"),
    (
        TipPoseEnv,
        {"randomize": {"stifness": 1.0}},
        r"randomize\.stifness is an unknown key .* did you mean 'stiffness'",
    ),
    (
        TipPoseEnv,
        {"randomize": {"stiffness": 0.0}},
        r"randomize\.segments\.\*\.young_modulus can draw .*greater than 0",
    ),
    (
        TipPoseEnv,
        {"randomize": {"density": 1.0, "segments.*.density": [2.0, 3.0]}},
        r"randomize\.segments\.\*\.density .*drawn already",
    ),
    (
        TipPoseEnv,
        {"randomize": {"tension_gain": [0.0, 1e300]}},
        r"randomize\.tension_gain is .* within ±1e\+09",
    ),
    (TipPoseEnv, {"randomize": {"latency": -0.1}}, r"randomize\.latency is .*at least 0"),
    (
        TipPoseEnv,
        {"randomize": {"latency": [0.0, 1e8]}},
        r"randomize\.latency is 1e\+08: it should be at most 1000 control periods, 20 s",
    ),
    (
        TipPoseEnv,
        {"randomize": {"noise": {"position": -0.1}}},
        r"randomize\.noise\.position is -0.1",
    ),
    (ShapeEnv, {"target": "circle"}, "target is 'circle', which is a pose alone"),
    (ReachEnv, {"reward": {"position": 1.0}}, "reward should be 'sparse' or 'dense'"),
    (ReachEnv, {"observation": ["target_error"]}, "observation names 'target_error'"),
]


@pytest.mark.parametrize(("kind", "options", "message"), BAD)
def test_bad_options_are_refused_by_name(kind, options, message):
    with pytest.raises(ConfigurationError, match=message) as caught:
        kind(**{**SMALL, **options})
    assert len(str(caught.value).splitlines()) == len(caught.value.problems)


@pytest.mark.parametrize(
    "options",
    [
        {"scene": SHIPPED / "three_tendon.toml"},
        {"scene": load_scene("three_tendon")},
        {"scene": scene_to_dict(load_scene("three_tendon"))},
        {"scene": {"scene": Path("three_tendon"), "segments.0.density": np.int64(1070)}},
        {
            "control_period": np.float32(0.02),
            "sensors": np.int64(2),
            "tension_limits": np.array([0, 5]),
            "preview": np.array([0.1]),
        },
        {"randomize": Randomization(latency=0.02), "target": Hold(tension=(1.0, 0.0, 0.0))},
    ],
    ids=["path", "scene", "table", "changes", "numpy", "configurations"],
)
def test_options_are_taken_as_they_come(options):
    env = gym.make(IDS["TipPose"], **{**SMALL, **options})
    assert (
        env.unwrapped.model.scene.segments
        == at_fidelity(load_scene("three_tendon"), "fast").segments
    )
    env.reset(seed=0)


@pytest.mark.parametrize(
    ("period", "ahead"),
    [(0.02, [5, 10]), (0.1, [1, 2]), (0.15, [1, 2]), (0.5, [1, 2]), (2.5, [1, 2]), (0.04, [2, 5])],
)
def test_previews_are_ahead_by_default_however_long_a_period_is(period, ahead):
    env = TipPoseEnv(**SMALL, control_period=period)
    expected_ahead = period * np.array([0, *ahead])
    np.testing.assert_allclose(env.episodes.ahead, expected_ahead)


BAD_ACTIONS = [
    np.zeros(4),
    np.zeros((1, 3)),
    0.0,
    [0.0, np.nan, 0.0],
    [np.inf, 0.0, 0.0],
    [[0.0], [0.0, 1.0]],
]
BAD_ACTIONS += ["up", [True] * 3, None, ["a"] * 3]


def test_bad_actions_are_refused_before_anything_changes(everything, live, same):
    env = TipPoseEnv(**SMALL, randomize=everything)
    twin = TipPoseEnv(**SMALL, randomize=everything)
    live(env, 0, 5)
    live(twin, 0, 5)
    for action in BAD_ACTIONS:
        with pytest.raises((ValueError, TypeError), match="^action should"):
            env.step(action)
        assert same(env.step(np.full(3, 0.3)), twin.step(np.full(3, 0.3)))


@pytest.mark.parametrize(
    ("drawn", "columns"),
    [
        ({}, 3),
        ({"damping": [1.0, 2.0], "stiffness": [0.5, 1.0]}, 3),
        # a twentieth of the damping beside the stiffness is too little for three
        ({"damping": [0.05, 1.0]}, 2),
        ({"stiffness": [1.0, 20.0]}, 2),
    ],
)
def test_columns_of_extrapolation_suit_the_stiffest_and_least_damped_arm(drawn, columns):
    table = {
        "scene": {"scene": "paper", "segments.0.damping": 300.0},
        "fidelity": "scene",
        "randomize": drawn,
    }
    options = Options.parse(table, "options")
    scene = resolved_scene(options)
    assert extrapolation_columns(scene) == columns
