"""What is no option and no action is refused by name, before anything changes."""

import numpy as np
import pytest

from soft_tendon_env.configuration import ConfigurationError
from soft_tendon_env.envs import ReachEnv, ShapeEnv, TipPoseEnv, TipPoseVectorEnv

SMALL = {"scene": "three_tendon", "fidelity": "fast"}
BAD = [
    ({"scen": "paper"}, r"scen is an unknown key \(given 'paper'\): did you mean 'scene'\?"),
    ({"scene": "papr"}, "'papr': is neither .* did you mean 'paper'"),
    ({"scene": "nowhere.toml"}, r"nowhere\.toml: cannot be read"),
    ({"scene": 5}, "scene is 5"),
    ({"scene": {"scene": 5}}, r"scene\.scene is 5: it should be the name"),
    ({"scene": {"segments.0.young_modulu": 1.0}}, r"segments\[0\]\.young_modulu is an unknown key"),
    ({"scene": {"name": "x", "segments": []}}, "segments"),
    ({"fidelity": "coarse"}, "fidelity is 'coarse': it should be 'fast', 'standard' or 'fine'"),
    ({"control_period": 0.0}, "control_period is 0.0: it should be greater than 0"),
    ({"control_period": np.nan}, "control_period is nan"),
    ({"control_period": True}, "control_period is True"),
    ({"tension_limits": [3.0, 1.0]}, r"tension_limits is \[3.0, 1.0\]: it should be \(least, greatest\)"),
    ({"tension_limits": [0.0, np.inf]}, "tension_limits.* is inf"),
    ({"tension_limits": 5.0}, "tension_limits is 5.0"),
    ({"action": "torque"}, "action is 'torque': it should be 'tension' or 'increment'"),
    ({"tension_rate": -1.0}, "tension_rate is -1.0"),
    ({"target": "circel"}, r"target\.type is 'circel': did you mean 'circle'\? valid: circle, hold, ramp, random"),
    ({"target": 3}, "target is 3"),
    ({"target": {}}, r"target\.type is missing"),
    ({"target": {"type": "circle", "radius": 0.0}}, r"target\.radius is 0.0"),
    ({"target": {"type": "circle", "radiu": 1.0}}, r"target\.radiu is an unknown key"),
    ({"target": {"type": "random", "fraction": 1.5}}, r"target\.fraction is 1.5: it should be less than or equal to 1"),
    ({"target": {"type": "hold", "tension": [1.0]}}, r"target\.tension has 1 entries: it should have one per tendon, 3"),
    ({"target": {"type": "hold", "tension": [1.0] * 3, "pose": np.eye(4)}}, "tension or pose, not both"),
    ({"target": {"type": "hold", "pose": 2 * np.eye(4)}}, "homogeneous matrix"),
    ({"target": {"type": "hold", "pose": np.eye(3)}}, r"target\.pose"),
    ({"observation": "everything"}, "observation is 'everything': .*valid: full, measurable, or a list of groups"),
    ({"observation": ["rates", "rate"]}, "observation names 'rate': did you mean 'rates'"),
    ({"observation": ["target_coordinates"]}, "observation names 'target_coordinates'"),
    ({"observation": ["wanted_coordinates"]}, "observation names 'wanted_coordinates'"),
    ({"observation": ["rates", "rates"]}, "each once"),
    ({"observation": []}, "at least one group"),
    ({"preview": [0.0]}, r"preview\[0\] is 0.0"),
    ({"preview": 0.1}, "preview is 0.1"),
    ({"sensors": [-0.1]}, r"sensors\[0\] is -0.1"),
    ({"sensors": 0}, "sensors is 0: it should be greater than or equal to 1"),
    ({"sensors": True}, "sensors is True"),
    ({"sensors": 0.1}, "sensors is 0.1"),
    ({"sensors": [0.4]}, "sensors names 0.4: it should be at most the rod's length, 0.3"),
    ({"reward": {"positon": 1.0}}, r"reward\.positon is no term of this task: did you mean 'position'"),
    ({"reward": {"backbone": 1.0}}, r"reward\.backbone is no term of this task"),
    ({"reward": {"position": -1.0}}, r"reward\.position\.weight is -1.0"),
    ({"reward": {"position": "much"}}, r"reward\.position\.weight is 'much'"),
    ({"reward": {"position": {"wight": 1.0}}}, r"reward\.position\.wight is an unknown key .* did you mean 'weight'"),
    ({"reward": {"position": 0.0}}, "reward should give at least one term a weight above 0"),
    ({"reward": {}}, "reward should give at least one term a weight above 0"),
    ({"reward": "sparse"}, "reward should be a table of weights by term"),
    ({"threshold": 0.0}, "threshold is 0.0"),
    ({"randomize": {"stifness": 1.0}}, r"randomize\.stifness is an unknown key .* did you mean 'stiffness'"),
    ({"randomize": {"stiffness": 0.0}}, r"randomize\.stiffness is .*greater than 0"),
    ({"randomize": {"stiffness": [1.2, 0.8]}}, r"randomize\.stiffness is .*\(least, greatest\)"),
    ({"randomize": {"latency": -0.1}}, r"randomize\.latency is .*at least 0"),
    ({"randomize": {"noise": {"positon": 0.1}}}, r"randomize\.noise\.positon is an unknown key"),
    ({"randomize": {"noise": {"position": -0.1}}}, r"randomize\.noise\.position is -0.1"),
    ({"randomize": True}, "randomize is True"),
    ({"on_divergence": "ignore"}, "on_divergence is 'ignore': it should be 'terminate', 'truncate' or 'raise'"),
]


@pytest.mark.parametrize("options, message", BAD, ids=lambda part: str(part)[:50] if isinstance(part, dict) else "")
def test_bad_options_are_refused_by_name(options, message):
    for make in (TipPoseEnv, TipPoseVectorEnv):
        with pytest.raises(ConfigurationError, match=message):
            make(**{**SMALL, **options})


@pytest.mark.parametrize(
    "kind, options, message",
    [
        (ShapeEnv, {"target": "circle"}, "target is 'circle', which is a pose alone"),
        (ShapeEnv, {"target": {"type": "hold", "pose": np.eye(4)}}, "target is 'hold', which is a pose alone"),
        (ShapeEnv, {"reward": "dense"}, "reward should be a table"),
        (ReachEnv, {"reward": {"position": 1.0}}, "reward should be 'sparse' or 'dense'"),
        (ReachEnv, {"reward": "sprase"}, "reward is 'sprase': it should be 'sparse' or 'dense'"),
        (ReachEnv, {"observation": ["target_error"]}, "observation names 'target_error'"),
    ],
)
def test_options_of_other_tasks_are_refused(kind, options, message):
    with pytest.raises(ConfigurationError, match=message):
        kind(**{**SMALL, **options})


def test_every_mistake_is_told_at_once():
    with pytest.raises(ConfigurationError) as caught:
        TipPoseEnv(actio="tension", threshold=-1.0, randomize={"stiffness": 0.0, "noise": {"length": -1.0}})
    assert len(caught.value.problems) == 4 and str(caught.value).count("TipPoseEnv: ") == 4


def test_unknown_render_modes_are_refused():
    with pytest.raises(ValueError, match="render_mode should be None, 'rgb_array' or 'human', not 'ascii'"):
        TipPoseEnv(render_mode="ascii", **SMALL)


BAD_ACTIONS = [
    np.zeros(4),
    np.zeros((1, 3)),
    0.0,
    [0.0, np.nan, 0.0],
    [np.inf, 0.0, 0.0],
    "up",
    [True] * 3,
    None,
    ["a"] * 3,
    [[0.0], [0.0, 1.0]],
]


@pytest.mark.parametrize("action", BAD_ACTIONS, ids=str)
def test_bad_actions_are_refused_before_anything_changes(action, everything, live, same):
    env, twin = (TipPoseEnv(**SMALL, randomize=everything) for _ in range(2))
    live(env, 0, 5)
    live(twin, 0, 5)
    with pytest.raises((ValueError, TypeError), match="^action should"):
        env.step(action)
    assert same(env.step(np.full(3, 0.3)), twin.step(np.full(3, 0.3)))


@pytest.mark.parametrize("actions", [np.zeros(3), np.zeros((3, 2)), np.full((2, 3), np.nan), "up", np.ones((2, 3), dtype=bool)], ids=str)
def test_bad_actions_of_rows_are_refused_before_anything_changes(actions, everything, same):
    vector, twin = (TipPoseVectorEnv(2, 2, **SMALL, randomize=everything) for _ in range(2))
    for env in (vector, twin):
        env.reset(seed=0)
        env.step(np.zeros((2, 3)))
    for _ in range(3):  # an ending step and a resetting one among them
        with pytest.raises((ValueError, TypeError), match="^actions should"):
            vector.step(actions)
        assert same(vector.step(np.full((2, 3), 0.3)), twin.step(np.full((2, 3), 0.3)))


def test_actions_of_every_numeric_type_are_taken(same):
    results = []
    for action in ([1, 0, -1], np.array([1, 0, -1], dtype=np.int8), np.array([1, 0, -1], dtype=np.float32), (1.0, 0.0, -1.0)):
        env = TipPoseEnv(**SMALL)
        env.reset(seed=0)
        results.append(env.step(action))
    assert all(same(result, results[0]) for result in results)


def test_tensions_that_cannot_hold_the_arm_are_refused():
    with pytest.raises(ConfigurationError, match=r"tension_limits leave .* cannot hold the arm"):
        TipPoseEnv(scene="three_tendon", tension_limits=[1000.0, 1500.0])
