"""What is no option and no action is refused by name, before anything changes."""

from pathlib import Path

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.envs.registration import EnvSpec
from gymnasium.vector import AutoresetMode

from soft_tendon_env import load_scene
from soft_tendon_env.accuracy.fidelity import at_fidelity
from soft_tendon_env.envs import IDS, ReachEnv, ShapeEnv, TipPoseEnv, TipPoseVectorEnv
from soft_tendon_env.envs.randomization import Randomization
from soft_tendon_env.envs.targets.set_points import Hold
from soft_tendon_env.scene.file import SHIPPED
from soft_tendon_env.scene.scene import scene_to_dict
from soft_tendon_env.tools.configuration import ConfigurationError

SMALL = {"scene": "three_tendon", "fidelity": "fast"}
FAR = [[1.0, 0.0, 0.0, 1e300], [0.0, 1.0, 0.0, 0.0], [0.0, 0.0, 1.0, 0.0], [0.0, 0.0, 0.0, 1.0]]
BAD = [
    ({"scen": "paper"}, r"scen is an unknown key \(given 'paper'\): did you mean 'scene'\?"),
    ({"scene": "papr"}, "'papr': is neither .* did you mean 'paper'"),
    ({"scene": "nowhere.toml"}, r"nowhere\.toml: cannot be read"),
    ({"scene": 5}, "scene is 5: it should be the name of a shipped scene, the path .*, a Scene, or a table, such as scene_to_dict gives$"),
    ({"scene": Path("nowhere.toml")}, r"nowhere\.toml: cannot be read"),
    ({"scene": {1: 2}}, "scene has the key 1: keys should be strings$"),
    ({"randomize": {1: 2}}, "randomize has the key 1: keys should be strings$"),
    ({"randomize": {"noise": {None: 0.1}}}, r"randomize\.noise has the key None: keys should be strings$"),
    ({"scene": {"segments.0.young_modulu": 1.0}}, r"segments\[0\]\.young_modulu is an unknown key"),
    ({"scene": {"name": "x", "segments": []}}, "segments"),
    ({"fidelity": "coarse"}, "fidelity is 'coarse': it should be 'fast', 'standard', 'fine', 'scene' or a length"),
    ({"control_period": 0.0}, "control_period is 0.0: it should be greater than 0"),
    ({"control_period": 1e-300}, "control_period is 1e-300: it should be at least 1e-06 s, and at most"),
    ({"control_period": 1e12}, r"control_period is 1e\+12: .* at most 10000 integrator steps of 0.02 s"),
    ({"scene": {"scene": "three_tendon", "integrator.step": 1e-7}, "fidelity": None}, "control_period is 0.02: .* steps of 1e-07 s"),
    ({"scene": {"scene": "three_tendon", "integrator.tolerance": 1e-12}}, r"integrator\.tolerance is 1e-12: it should be at least 3e-12 m"),
    ({"tension_limits": [3.0, 1.0]}, r"tension_limits is \[3.0, 1.0\]: it should be \(least, greatest\)"),
    ({"tension_limits": [0.0, np.inf]}, "tension_limits.* is inf"),
    ({"tension_limits": 5.0}, r"tension_limits is 5.0: it should be \(least, greatest\)"),
    ({"tension_limits": [-1e308, 1e308]}, r"tension_limits is .* within ±1e\+09 N"),
    ({"scene": {"scene": "three_tendon", "tendons.1.tension_limits": [0, 1e300]}}, r"tendons\[1\]\.tension_limits is .* within ±1e\+09 N"),
    ({"action": "torque"}, "action is 'torque': it should be 'tension' or 'increment'"),
    ({"tension_rate": -1.0}, "tension_rate is -1.0"),
    ({"target": "circel"}, r"target\.type is 'circel': did you mean 'circle'\? valid: circle, hold, out_of_reach, ramp, random, steps"),
    ({"target": 3}, "target is 3"),
    ({"target": {"type": "circle", "radius": 1e300}}, r"target\.radius is 1e\+300"),
    ({"target": {"type": "random", "knot_period": 20.0}}, r"target\.knot_period is 20: it should be 0.001 to 2.5 s, for 4 to 10000 in a"),
    ({"target": {"type": "random", "period": 2.0}}, r"target\.knot_period is 1: it should be 0.0002 to 0.5 s"),
    ({"target": {}}, r"target\.type is missing"),
    ({"target": {"type": "circle", "radiu": 1.0}}, r"target\.radiu is an unknown key"),
    ({"target": {"type": "random", "fraction": [0.5, 0.2]}}, r"target\.fraction is \[0\.5, 0\.2\]: it should be a number greater than 0"),
    ({"target": {"type": "random", "fraction": 1.5}}, r"target\.fraction is 1.5: it should be a number greater than 0 and at most 1"),
    ({"target": {"type": "hold", "tension": [1.0]}}, r"target\.tension has 1 entries: it should have one per tendon, 3"),
    ({"target": {"type": "hold", "tension": [1.0] * 3, "pose": np.eye(4)}}, "tension or pose, not both"),
    ({"target": {"type": "hold", "pose": 2 * np.eye(4)}}, "homogeneous matrix"),
    ({"target": {"type": "hold", "pose": np.eye(3)}}, r"target\.pose"),
    ({"target": {"type": "hold", "pose": FAR}}, r"target\.pose is .* a homogeneous matrix .* within ±1e\+06 m$"),
    ({"observation": "everything"}, "observation is 'everything': .*valid: full, measurable, or a list of groups"),
    ({"observation": ["rates", "rate"]}, "observation names 'rate': did you mean 'rates'"),
    ({"observation": ["target_coordinates"]}, "observation names 'target_coordinates'"),
    ({"observation": ["rates", "rates"]}, "each once"),
    ({"observation": []}, "at least one group"),
    ({"observation": ["rates", 1]}, "observation is .* 1]: it should be 'full', 'measurable' or a list of the names of groups$"),
    ({"preview": [0.0]}, r"preview\[0\] is 0.0"),
    ({"preview": [0.1, 0.0099]}, r"preview\[1\] is 0.0099: it should be more than half a control period, 0.01 s, and at most 10000"),
    ({"preview": [0.2], "control_period": 0.5}, r"preview\[0\] is 0.2: it should be more than half a control period, 0.25 s"),
    ({"preview": [1e7]}, r"preview\[0\] is 1e\+07: it should be .* and at most 10000 of them, 200 s"),
    ({"preview": 0.1}, "preview is 0.1"),
    ({"sensors": [-0.1]}, r"sensors\[0\] is -0.1"),
    ({"sensors": 0}, "sensors is 0: it should be greater than or equal to 1"),
    ({"sensors": 0.1}, "sensors is 0.1: it should be a whole number, or a list of arc lengths"),
    ({"sensors": 10**9}, "sensors is 1000000000: it should be less than or equal to 10000"),
    ({"sensors": "2"}, "sensors is '2': it should be a whole number, or a list of arc lengths"),
    ({"sensors": [0.4]}, "sensors names 0.4: it should be at most the rod's length, 0.3"),
    ({"reward": {"positon": 1.0}}, r"reward\.positon is no term of this task: did you mean 'position'"),
    ({"reward": {"position": -1.0}}, r"reward\.position\.weight is -1.0"),
    ({"reward": {"position": "much"}}, r"reward\.position\.weight is 'much'"),
    ({"reward": {"position": {"wight": 1.0}}}, r"reward\.position\.wight is an unknown key .* did you mean 'weight'"),
    ({"reward": {"position": 0.0}}, "reward should give at least one term a weight above 0"),
    ({"reward": {}}, "reward should give at least one term a weight above 0"),
    ({"reward": "sparse"}, "reward should be a table of weights by term"),
    ({"reward": {"position": 1e308, "angle": 1e308}}, r"reward\.position\.weight is 1e\+308"),
    ({"reward": {"position": {"scale": 1e-300}}}, r"reward\.position\.scale\[0\] is 1e-300"),
    ({"threshold": 1e-300}, "threshold is 1e-300"),
    ({"randomize": {"stifness": 1.0}}, r"randomize\.stifness is an unknown key .* did you mean 'stiffness'"),
    ({"randomize": {"stiffness": 0.0}}, r"randomize\.segments\.\*\.young_modulus can draw .*greater than 0"),
    ({"randomize": {"stiffness": [1.2, 0.8]}}, r"randomize\.segments\.\*\.young_modulus has \[1.2, 0.8\]: the least should come first"),
    ({"randomize": {"stiffness": 1e-300}}, r"randomize\.segments\.\*\.young_modulus can draw .*should be 1e-20 to 1e\+20"),
    (
        {"randomize": {"damping": [1.0, 2.0, 3.0]}},
        r"randomize\.segments\.\*\.damping has .*: it should be a number, or \(least, greatest\)$",
    ),
    ({"randomize": {"payload": "heavy"}}, r"randomize\.effects\.tip_load\.mass has 'heavy': it should be a number, or \(least, greatest\)"),
    ({"randomize": {"density": 1.0, "segments.*.density": [2.0, 3.0]}}, r"randomize\.segments\.\*\.density .*drawn already"),
    ({"randomize": {"tension_gain": [0.0, 1e300]}}, r"randomize\.tension_gain is .* within ±1e\+09"),
    ({"randomize": {"tension_offset": [-1e308, 1e308]}}, r"randomize\.tension_offset is .* within ±1e\+09"),
    ({"randomize": {"latency": -0.1}}, r"randomize\.latency is .*at least 0"),
    ({"randomize": {"latency": [0.0, 1e8]}}, r"randomize\.latency is 1e\+08: it should be at most 1000 control periods, 20 s"),
    ({"randomize": {"noise": {"rotation": 1e300}}}, r"randomize\.noise\.rotation is 1e\+300"),
    ({"randomize": {"noise": {"position": -0.1}}}, r"randomize\.noise\.position is -0.1"),
    ({"on_divergence": "ignore"}, "on_divergence is 'ignore': it should be 'terminate', 'truncate' or 'raise'"),
]


@pytest.mark.cases("options, message", BAD)
def test_bad_options_are_refused_by_name(options, message):
    for make in (TipPoseEnv, TipPoseVectorEnv):
        with pytest.raises(ConfigurationError, match=message) as caught:
            make(**{**SMALL, **options})
        assert len(str(caught.value).splitlines()) == len(caught.value.problems)


@pytest.mark.cases(
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


ODD = {
    "a path": ({"scene": SHIPPED / "three_tendon.toml"}, {}),
    "a name as a path": ({"scene": Path("three_tendon")}, {}),
    "a scene": ({"scene": load_scene("three_tendon")}, {}),
    "a whole table": ({"scene": scene_to_dict(load_scene("three_tendon"))}, {}),
    "a scene and changes": ({"scene": {"scene": load_scene("three_tendon"), "segments.0.density": 900.0}}, {"segments.0.density": 900.0}),
    "a path and changes": ({"scene": {"scene": Path("three_tendon"), "segments.0.density": np.int64(900)}}, {"segments.0.density": 900.0}),
    "numbers of NumPy": (
        {"control_period": np.float32(0.5), "threshold": np.float64(0.1), "sensors": np.int64(2), "tension_limits": np.array([0, 5])}, {}
    ),
    "nested": ({"randomize": {"stiffness": np.array([0.5, 1.0]), "noise": {"position": np.float32(0.5)}}, "preview": np.array([0.1])}, {}),
    "a target's table": ({"target": {"type": "hold", "tension": np.array([1.0, 0.0, 0.0])}, "sensors": [0.1, 0.2]}, {}),
    "configurations": ({"randomize": Randomization(latency=0.02), "target": Hold(tension=(1.0, 0.0, 0.0))}, {}),
}  # fmt: skip
"""Options as users have them, and what they change of the scene."""


@pytest.mark.parametrize("id", IDS.values())
@pytest.mark.parametrize("given", ODD)
def test_options_are_taken_as_they_come_and_go_to_json(given, id, live, same):
    """With the spec's JSON the same environment is made again, single and vector."""
    options, changes = ODD[given]
    options = {**SMALL, **options}
    env = gym.make(id, max_episode_steps=9, **options)
    assert env.unwrapped.model.scene == at_fidelity(load_scene("three_tendon").replace(changes), "fast")
    again = gym.make(EnvSpec.from_json(env.spec.to_json()))
    assert same(live(env, 1, 12), live(again, 1, 12))
    vector = gym.make_vec(id, num_envs=np.int64(2), autoreset_mode=AutoresetMode.SAME_STEP, **options)
    twin = gym.make_vec(EnvSpec.from_json(vector.spec.to_json()))
    assert twin.metadata == vector.metadata and same(twin.reset(seed=1), vector.reset(seed=1))


@pytest.mark.cases("period, ahead", [(0.02, [5, 10]), (0.1, [1, 2]), (0.15, [1, 2]), (0.5, [1, 2]), (2.5, [1, 2]), (0.04, [2, 5])])
def test_previews_are_ahead_by_default_however_long_a_period_is(period, ahead):
    env = TipPoseEnv(**SMALL, control_period=period)
    np.testing.assert_allclose(env.episodes.ahead, period * np.array([0, *ahead]))


@pytest.mark.parametrize("kind", [TipPoseEnv, TipPoseVectorEnv])
def test_a_tolerance_that_no_step_meets_is_told(kind):
    scene = {"scene": "three_tendon", "integrator.tolerance": 1e-10, "integrator.max_halvings": 2}
    env = kind(scene=scene)
    env.reset(seed=0)
    *_, info = env.step(np.ones(env.action_space.shape))
    (cause,) = np.atleast_1d(info["cause"])
    assert info["diverged"]
    assert cause.startswith("the estimated error is above integrator.tolerance, 1e-10 m, even with steps of 0.005 s, 2 halvings")


def test_every_mistake_is_told_at_once():
    with pytest.raises(ConfigurationError) as caught:
        TipPoseEnv(actio="tension", threshold=-1.0, randomize={"latency": -1.0, "noise": {"length": -1.0}})
    assert len(caught.value.problems) == 4 and str(caught.value).count("TipPoseEnv: ") == 4


def test_unknown_render_modes_are_refused():
    with pytest.raises(ValueError, match="render_mode should be None, 'rgb_array' or 'human', not 'ascii'"):
        TipPoseEnv(render_mode="ascii", **SMALL)


BAD_ACTIONS = [np.zeros(4), np.zeros((1, 3)), 0.0, [0.0, np.nan, 0.0], [np.inf, 0.0, 0.0], [[0.0], [0.0, 1.0]]]


@pytest.mark.cases("action", [*BAD_ACTIONS, "up", [True] * 3, None, ["a"] * 3])
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
