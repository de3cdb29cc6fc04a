"""Effects drawn at every reset: a row moves as a scene with these numbers does, rows as single environments; the rest is refused."""

import numpy as np
import pytest

from soft_tendon_env.envs import ReachEnv, ReachVectorEnv, TipPoseEnv, TipPoseVectorEnv
from soft_tendon_env.envs.options import Options
from soft_tendon_env.model.contact_forces import contact_forces
from soft_tendon_env.model.model import build_model
from soft_tendon_env.model.simulation import Simulation
from soft_tendon_env.model.statics import static_equilibrium
from soft_tendon_env.tools.configuration import ConfigurationError

GRAVITY = {"effects.gravity.acceleration": [0.0, 0.0, -9.81]}
BALL = {"type": "sphere", "position": [0.25, 0.05, 0.0], "radius": 0.02, "friction": 0.3}
FLOOR = {"type": "plane", "position": [0.0, 0.0, -0.05]}
CASES = {
    "gravity": (GRAVITY, {"gravity.acceleration": [[-1.0, 1.0], 0.5, [-9.0, -5.0]]}),
    "tip_load": (
        {**GRAVITY, "effects.tip_load": {"force": [0.0, 0.02, 0.01], "mass": 0.003, "inertia": [1e-7, 1e-7, 1e-7]}},
        {"tip_load.force.1": [-0.02, 0.02], "tip_load.mass": [0.001, 0.006], "tip_load.inertia": {"factor": [0.5, 2.0]}},
    ),
    "fluid": (
        {**GRAVITY, "effects.fluid": {"density": 1000.0, "current": [0.0, 0.1, 0.0]}},
        {"fluid.density": {"factor": [0.9, 1.1]}, "fluid.current": [0.0, [-0.3, 0.3], [0.0, 0.2]], "fluid.added_mass": [0.5, 1.5]},
    ),
    "disturbance": (
        {"effects.disturbance.loads": [{"at": 0.2, "force": [0.0, 0.05, 0.0], "signal": {"type": "sine", "frequency": 2.0}}]},
        {"disturbance.loads.0.at": [0.1, 0.3], "disturbance.loads[0].signal.frequency": [1.0, 3.0]},
    ),
    "nonlinear_elasticity": ({"effects.nonlinear_elasticity.bending": 5.0}, {"nonlinear_elasticity.bending": [3.0, 8.0]}),
    "viscoelastic_memory": (
        {"effects.viscoelastic_memory.branches": [{"modulus": 0.5, "relaxation_time": 0.1}]},
        {"viscoelastic_memory.branches.0.modulus": [0.2, 1.0], "viscoelastic_memory.branches.0.relaxation_time": [0.05, 0.2]},
    ),
    "contact": (
        {**GRAVITY, "effects.contact.obstacles": [BALL, FLOOR]},
        {"contact.obstacles.0.position": [0.25, [0.04, 0.06], [-0.02, 0.02]], "contact.obstacles.1.friction": [0.1, 0.5]},
    ),
    "moving_base": (
        {"effects.moving_base": {"amplitude": [0.0, 0.01, 0.0], "frequency": 2.0}},
        {"moving_base.amplitude": [0.0, [0.0, 0.02], 0.0], "moving_base.frequency": [1.0, 3.0]},
    ),
    "loads inside": (
        {**GRAVITY, "effects.tip_load.force": [0.0, 0.01, 0.0], "strain.include_loads": True},
        {"gravity.acceleration.2": [-10.0, -5.0], "tip_load.force": [0.0, [-0.01, 0.01], 0.0]},
    ),
}


def options_of(case, **more):
    changes, ranges = CASES[case]
    scene = {"scene": "three_tendon", "quadrature.intervals": 6, **changes}
    return {"scene": scene, "fidelity": "fast", "randomize": {"effects": ranges}, **more}


def scene_with(env, row=0):
    """The scene of an environment with the numbers that were drawn for a row."""
    drawn = {f"effects.{key}": value.tolist() for key, value in env.episodes.drawn_effects(row).items()}
    drawn["quadrature.intervals"] = env.episodes.model.grid.per_piece  # which other numbers may change
    return env.episodes.model.scene.replace(drawn)


@pytest.mark.parametrize("case", CASES)
def test_a_row_moves_like_the_scene_with_the_numbers_drawn(case):
    env = TipPoseEnv(**options_of(case))
    env.reset(seed=3)
    model = build_model(scene_with(env))
    simulation = Simulation(model)
    simulation.reset(static_equilibrium(model, np.zeros(3), settle=True).q)
    np.testing.assert_allclose(env.episodes.arms.reading.tip_pose[0], simulation.tip_pose, atol=1e-8)
    rng, scenes = np.random.default_rng(0), Simulation(env.model)
    for _ in range(15):
        action = rng.uniform(-1.0, 1.0, 3)
        env.step(action)
        for each in (simulation, scenes):
            each.step(2.5 * (action + 1.0), 0.02)
        np.testing.assert_allclose(env.episodes.arms.reading.tip_pose[0], simulation.tip_pose, atol=1e-7)
    np.testing.assert_allclose(env.state.effects, simulation.state.effects, atol=1e-6)
    assert np.abs(scenes.tip_pose - simulation.tip_pose).max() > 1e-6, "what is drawn matters"


@pytest.mark.parametrize("case", ["fluid", "contact"])
def test_rows_are_single_environments_and_differ(case, same, rows_alike):
    vector, singles = TipPoseVectorEnv(3, **options_of(case)), [TipPoseEnv(**options_of(case)) for _ in range(3)]
    assert len([*rows_alike(vector, dict(enumerate(singles)), 6)]) == 6
    drawn = [vector.episodes.drawn_effects(row) for row in range(3)]
    for row, env in enumerate(singles):
        assert same(drawn[row], env.episodes.drawn_effects(0))
    assert not same(drawn[0], drawn[1])
    first = singles[0].episodes.drawn_effects(0)
    singles[0].reset()
    assert not same(first, singles[0].episodes.drawn_effects(0)), "drawn anew at every reset"
    singles[0].reset(seed=5)
    assert same(first, singles[0].episodes.drawn_effects(0))


def test_numbers_lie_within_their_ranges():
    env = TipPoseEnv(**options_of("fluid"))
    for seed in range(10):
        env.reset(seed=seed)
        drawn = env.episodes.drawn_effects(0)
        assert 900.0 <= drawn["fluid.density"] <= 1100.0
        x, y, z = drawn["fluid.current"]
        assert x == 0.0 and -0.3 <= y <= 0.3 and 0.0 <= z <= 0.2


def test_contact_is_told_by_the_obstacles_of_the_row():
    scene = {"scene": "three_tendon", "quadrature.intervals": 6, **GRAVITY, "effects.contact.obstacles": [FLOOR]}
    options = {"scene": scene, "fidelity": "fast", "randomize": {"effects": {"contact.obstacles.0.position.2": [-0.045, -0.03]}}}
    vector = TipPoseVectorEnv(3, **options, observation=["clearance", "contact_force"])
    vector.reset(seed=0)
    for _ in range(30):
        vector.step(-np.ones((3, 3)))
    lowest = [vector.episodes.drawn_effects(row)["contact.obstacles.0.position.2"] for row in range(3)]
    assert np.ptp(lowest) > 1e-3
    for row in range(3):
        model = build_model(scene_with(vector, row))
        told, expected = vector.episodes.contact_forces(row), contact_forces(model, vector.episodes.state(row))
        assert expected.force[0, 2] > 1e-3
        np.testing.assert_allclose(told.force, expected.force, rtol=1e-9)
        np.testing.assert_allclose(told.clearance, expected.clearance, rtol=1e-9)
    vector.close()


WRONG = {
    "an unknown effect": ({"fluidity.density": 1.0}, "fluidity.density is of no effect: did you mean 'fluid'?"),
    "an unknown parameter": ({"fluid.densty": 1.0}, "fluid.densty is no parameter of fluid: did you mean 'density'?"),
    "an obstacle too many": ({"contact.obstacles.4.radius": 1.0}, "'4' should be 0 to 1"),
    "a text": ({"contact.obstacles.0.type": 1.0}, "parameters that are numbers"),
    "a short vector": ({"fluid.current": [0.0, [0.0, 1.0]]}, "it should be a list of 3"),
    "the wrong way round": ({"fluid.density": [2.0, 1.0]}, "the least should come first"),
    "no number": ({"fluid.density": "heavy"}, "it should be a number, or (least, greatest)"),
    "a negative density": ({"fluid.density": [-1.0, 1000.0]}, "can draw -1.0, which the effect refuses: effects: fluid.density is -1.0"),
    "off the rod": ({"disturbance.loads.0.at": [0.1, 0.4]}, "disturbance.loads.0.at can draw 0.4, which the effect refuses"),
    "twice": ({"fluid.current": [0, 0, 0], "fluid.current.1": [0.0, 1.0]}, "draws what 'fluid.current' draws already"),
    "a factor of nothing": ({"contact.stiffness": {"factor": 2.0}}, "the scene gives no value"),
    "no table": ([1], "randomize.effects is [1]: it should be a table from keys"),
}


@pytest.mark.cases("how", WRONG)
def test_what_cannot_be_drawn_is_refused_when_the_environment_is_made(how):
    ranges, text = WRONG[how]
    effects = {
        "effects.gravity.acceleration": [0.0, 0.0, -9.81],
        "effects.fluid.density": 1000.0,
        "effects.contact.obstacles": [{**BALL, "friction": 0.0}, FLOOR],
        "effects.disturbance.loads": [{"at": 0.2, "force": [0.0, 0.0, 0.0]}],
    }
    with pytest.raises(ConfigurationError) as error:
        ReachEnv(scene={"scene": "three_tendon", "quadrature.intervals": 6, **effects}, fidelity="fast", randomize={"effects": ranges})
    assert text in str(error.value) and "randomize.effects" in str(error.value) and "\n" not in str(error.value)


def test_tables_in_tables_are_dotted_keys():
    """As they come from TOML."""
    nested = {"fluid": {"density": [900, 1100], "current": {"factor": [0, 1]}}, "contact": {"obstacles": {"0": {"radius": 0.02}}}}
    dotted = {"fluid.density": [900, 1100], "fluid.current": {"factor": [0, 1]}, "contact.obstacles.0.radius": 0.02}
    assert Options(randomize={"effects": nested}) == Options(randomize={"effects": dotted})


def test_loads_that_would_no_longer_be_dead_stay_out_of_the_strain():
    """Of a load that follows the tip nothing is inside; one of size zero is."""
    changes = {**GRAVITY, "effects.tip_load": {"force": [0.0, 0.0, 0.0], "frame": "tip"}, "strain.include_loads": True}
    with pytest.raises(ConfigurationError, match="takes dead loads inside"):
        TipPoseEnv(scene={"scene": "three_tendon", **changes}, fidelity="fast", randomize={"effects": {"tip_load.force.1": [0.0, 0.01]}})


def test_an_arm_that_cannot_be_held_is_refused_when_the_environment_is_made():
    with pytest.raises(ConfigurationError, match="cannot hold"):
        TipPoseEnv(
            scene={"scene": "three_tendon", "effects.gravity.acceleration": [-9.81, 0.0, 0.0], "segments.0.young_modulus": 2e5},
            fidelity="fast",
            randomize={"effects": {"gravity.acceleration.0": {"factor": [1.0, 1e4]}}},
        )


def test_obstacles_are_drawn_again_where_the_arm_would_begin():
    """And refused where it always would."""
    ball = {"type": "sphere", "position": [0.15, 0.1, 0.0], "radius": 0.03}
    scene = {"scene": "three_tendon", "quadrature.intervals": 6, "effects.contact.obstacles": [ball]}
    env = ReachEnv(scene=scene, fidelity="fast", randomize={"effects": {"contact.obstacles.0.position.1": [-0.05, 0.05]}})
    for seed in range(5):
        env.reset(seed=seed)
        assert env.episodes.contact_forces(0).penetration[0] < 1e-3
    near_the_base = {"contact.obstacles.0.position": [0.02, [0.0, 0.001], 0.0]}
    env = ReachEnv(scene=scene, fidelity="fast", randomize={"effects": near_the_base})
    with pytest.raises(ConfigurationError, match="begin inside of an obstacle"):
        env.reset(seed=0)


def test_targets_keep_clear_of_the_row_s_obstacles():
    ball = {"type": "sphere", "position": [0.25, 0.0, 0.15], "radius": 0.05}
    scene = {"scene": "three_tendon", "quadrature.intervals": 6, "effects.contact.obstacles": [ball]}
    ranges = {"contact.obstacles.0.position": [[0.2, 0.3], [-0.1, 0.1], [0.08, 0.12]]}
    vector = ReachVectorEnv(12, scene=scene, fidelity="fast", target={"type": "hold", "fraction": 0.6}, randomize={"effects": ranges})
    vector.reset(seed=0)
    close = 0
    for row in range(12):
        place = vector.episodes.drawn_effects(row)["contact.obstacles.0.position"]
        away = np.linalg.norm(vector.episodes.target_pose[row, :3, 3] - place)
        assert away > 0.05 + 0.9 * 0.01
        close += away < 0.1
    assert close > 0
    vector.close()
