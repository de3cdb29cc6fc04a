"""Arms drawn at every reset: a row moves as a scene with these numbers does, rows as single
environments; the rest is refused."""

import pickle

import numpy as np
import pytest

from soft_tendon_env import ConfigurationError, Simulation, load_scene, static_equilibrium
from soft_tendon_env.envs import ReachEnv, TipPoseEnv, TipPoseVectorEnv
from soft_tendon_env.envs.contacts import why_inside
from soft_tendon_env.envs.starts import BANK
from soft_tendon_env.model.build import build_model

SMALL = {"scene": "three_tendon", "fidelity": "fast"}
GRAVITY = {"effects.gravity.acceleration": [0.0, 0.0, -9.81]}
SAGGING = {"effects.gravity.acceleration": [-9.81, 0.0, 0.0], "segments.0.young_modulus": 2e5}
BALL = {"type": "sphere", "position": [0.25, 0.05, 0.0], "radius": 0.02}
FLOOR = {"type": "plane", "position": [0.0, 0.0, -0.05]}
CASES = {
    "tip_load": (
        {
            **GRAVITY,
            "effects.tip_load": {
                "force": [0.0, 0.02, 0.01],
                "mass": 0.003,
                "inertia": [1e-7, 1e-7, 1e-7],
            },
        },
        {
            "effects.tip_load.force.1": [-0.02, 0.02],
            "effects.tip_load.mass": [0.001, 0.006],
            "effects.tip_load.inertia": {"factor": [0.5, 2.0]},
        },
    ),
    "contact": (
        {**GRAVITY, "effects.contact": {"obstacles": [BALL, FLOOR], "friction": 0.3}},
        {"effects.contact.friction": [0.1, 0.5], "segments.*.density": {"factor": [0.5, 2.0]}},
    ),
    "material": (
        {**GRAVITY, "tendons.0.routing.offset": [0.01, 0.0]},
        {
            "segments.*.young_modulus": {"factor": [0.8, 1.2]},
            "segments.0.poisson_ratio": [0.3, 0.5],
            "segments.0.radius": {"offset": [-1e-3, 1e-3]},
            "tendons.0.routing.offset": [[0.009, 0.011], {"offset": [-1e-3, 1e-3]}],
            "payload": [0.0, 0.01],
        },
    ),
    "loads inside": (
        {**GRAVITY, "effects.tip_load.force": [0.0, 0.01, 0.0], "strain.include_loads": True},
        {
            "effects.gravity.acceleration.2": [-10.0, -5.0],
            "effects.tip_load.force": [0.0, [-0.01, 0.01], 0.0],
        },
    ),
}
WRONG = {
    "an unknown number": (
        {"fluid.densty": 1.0},
        "effects.fluid.densty is no number of the scene: did you mean 'effects.fluid.density'?",
    ),
    "a text": ({"contact.obstacles.0.type": 1.0}, "is no parameter: 'sphere' is no number"),
    "a short vector": ({"fluid.current": [0.0, [0.0, 1.0]]}, "it should be a list of 3"),
    "the wrong way round": ({"fluid.density": [2.0, 1.0]}, "the least should come first"),
    "a negative density": (
        {"fluid.density": [-1.0, 1000.0]},
        "can draw effects.fluid.density -1, which the scene refuses: scene: effects.",
    ),
    "twice": (
        {"fluid.current": [0, 0, 0], "fluid.current.1": [0.0, 1.0]},
        "draws what 'effects.fluid.current.1' draws already",
    ),
}


@pytest.mark.parametrize(
    "case", [pytest.param(case, marks=[pytest.mark.slow] * (case == "contact")) for case in CASES]
)
def test_a_row_moves_like_the_scene_with_the_numbers_drawn(case):
    changes, ranges = CASES[case]
    scene = {"scene": "three_tendon", "quadrature.intervals": 6, **changes}
    env = TipPoseEnv(scene=scene, fidelity="fast", randomize=ranges, action="tension")
    env.reset(seed=3)
    drawn = env.episodes.arms.model_of(0).scene
    model = build_model(drawn.replace({"quadrature.intervals": env.episodes.model.grid.per_piece}))
    simulation = Simulation(model)
    simulation.reset(static_equilibrium(model, np.zeros(3), settle=True).q)
    np.testing.assert_allclose(
        env.episodes.arms.reading.tip_pose[0], simulation.tip_pose, atol=1e-8
    )
    rng = np.random.default_rng(0)
    scenes = Simulation(env.model)
    for _ in range(15):
        action = rng.uniform(-1.0, 1.0, 3)
        env.step(action)
        for each in (simulation, scenes):
            each.step(2.5 * (action + 1.0), 0.02)
        np.testing.assert_allclose(
            env.episodes.arms.reading.tip_pose[0], simulation.tip_pose, atol=1e-7
        )
    np.testing.assert_allclose(env.state.effects, simulation.state.effects, atol=1e-6)
    assert np.abs(scenes.tip_pose - simulation.tip_pose).max() > 1e-6, "what is drawn matters"


def test_episodes_take_arms_of_a_bank_that_the_options_alone_decide(same):
    """The same ones for the same seed in every fresh environment, in rows too, before and after
    others, and after a pickle."""
    options = {
        **SMALL,
        "randomize": {"segments.*.density": {"factor": [0.5, 2.0]}, "latency": [0.0, 0.03]},
    }
    first = TipPoseEnv(**options)
    second = TipPoseEnv(**options)
    rows = TipPoseVectorEnv(2, **options)
    found = {}
    for seed in range(300):
        observation, _ = first.reset(seed=seed)
        found[seed] = (
            first.episodes.arms.model_of(0).scene.segments[0].density,
            first.episodes.actuation.delay(0),
            observation,
        )
    drawn = {density for density, *_ in found.values()}
    assert 55 < len(drawn) <= BANK
    assert 0.9 < min(drawn) / (0.5 * 1070) < 1.1
    assert 0.9 < max(drawn) / (2.0 * 1070) < 1.1
    for seed in (250, 7, 1):
        for env, row in ((second, 0), (rows, 1), (pickle.loads(pickle.dumps(first)), 0)):
            observation, _ = env.reset(seed=seed - row)
            again = (
                env.episodes.arms.model_of(row).scene.segments[0].density,
                env.episodes.actuation.delay(row),
                observation,
            )
            assert same((*again[:2], observation[row] if row else observation), found[seed])
    assert same(first.reset(seed=5)[0], first.reset(seed=5)[0])
    assert not same(first.reset()[0], first.reset()[0])


def test_info_has_what_was_drawn_where_episodes_begin():
    """By the keys of the scene and the names of `randomize`, in rows as Gymnasium has tables:
    arrays beside masks."""
    assert "drawn" not in TipPoseEnv(**SMALL).reset(seed=0)[1]
    ranges = {
        "segments.*.density": {"factor": [0.5, 2.0]},
        "payload": [0.0, 0.01],
        "tension_offset": [-0.1, 0.1],
        "latency": [0.0, 0.03],
    }
    env = TipPoseEnv(**SMALL, randomize=ranges)
    rows = TipPoseVectorEnv(3, 2, **SMALL, randomize=ranges)
    found = env.reset(seed=5)[1]["drawn"]
    _, info = rows.reset(seed=4)
    none = np.zeros((3, 3))
    scene = env.episodes.arms.model_of(0).scene
    actuation = env.episodes.actuation
    assert {*found} == {
        "segments.0.density",
        "effects.tip_load.mass",
        "tension_gain",
        "tension_offset",
        "latency",
    }
    assert found["segments.0.density"] == scene.segments[0].density
    assert found["effects.tip_load.mass"] == scene.effects.tip_load.mass
    assert found["latency"] == actuation.delay(0)
    assert (found["tension_offset"] == actuation.offset[0]).all()
    assert all(
        (info["drawn"][key][1] == value).all() and info["drawn"][f"_{key}"].all()
        for key, value in found.items()
    )
    assert info["_drawn"].all()
    assert "drawn" not in env.step(none[0])[4]
    rows.reset(
        options={"reset_mask": np.array([True, False, False]), "episode_steps": [1, None, None]}
    )
    infos = [rows.step(none)[4] for _ in range(3)]
    assert "drawn" not in infos[0]
    assert [info["_drawn"].tolist() for info in infos[1:]] == [
        [True, False, False],
        [False, True, True],
    ]
    assert (
        (infos[2]["drawn"]["segments.0.density"] > 0.0).tolist()
        == infos[2]["drawn"]["_latency"].tolist()
        == [False, True, True]
    )


@pytest.mark.parametrize("how", WRONG)
def test_what_cannot_be_drawn_is_refused_when_the_environment_is_made(how):
    ranges, text = WRONG[how]
    effects = {
        "effects.gravity.acceleration": [0.0, 0.0, -9.81],
        "effects.fluid.density": 1000.0,
        "effects.contact": {"obstacles": [BALL, FLOOR]},
        "effects.disturbance.loads": [{"at": 0.2, "force": [0.0, 0.0, 0.0]}],
    }
    with pytest.raises(ConfigurationError) as error:
        ReachEnv(
            scene={"scene": "three_tendon", "quadrature.intervals": 6, **effects},
            fidelity="fast",
            randomize={"effects": ranges},
        )
    assert text in str(error.value)
    assert "randomize.effects" in str(error.value)
    assert "\n" not in str(error.value)


@pytest.mark.filterwarnings("ignore:.*only in a trial")  # which the sagging arm passes in part
@pytest.mark.parametrize(
    ("changes", "ranges", "message"),
    [
        (
            {},
            {"segments.0.length": [0.2, 0.3]},
            "segments.0.length is no parameter: it decides where the quadrature points lie",
        ),
        ({}, {"quadrature.intervals": 4}, "quadrature.intervals is an unknown key"),
        pytest.param(
            SAGGING,
            {"effects": {"gravity.acceleration.0": {"factor": [1.0, 1e4]}}},
            "cannot begin at rest",
            marks=pytest.mark.slow,  # after many tries
        ),
    ],
)
def test_other_keys_that_cannot_be_drawn_are_refused(changes, ranges, message):
    with pytest.raises(ConfigurationError, match=message):
        TipPoseEnv(scene={"scene": "three_tendon", **changes}, fidelity="fast", randomize=ranges)


PILLAR = {"type": "sphere", "position": [0.01, 0.06, 0.0], "radius": 0.03}
BLOCKED = {
    "obstacles": (PILLAR, {"effects.contact.obstacles.0.position": [0.01, [0.045, 0.06], 0.0]}),
    "base": (PILLAR, {"base.position": [0.0, [0.015, 0.03], 0.0]}),
}


@pytest.mark.parametrize("drawn", BLOCKED)
def test_draws_that_obstacles_keep_from_resting_are_drawn_anew(drawn):
    obstacle, ranges = BLOCKED[drawn]
    env = TipPoseEnv(
        scene={"scene": "three_tendon", "effects.contact.obstacles": [obstacle]},
        fidelity="scene",
        randomize=ranges,
    )
    drawn_numbers = set()
    for seed in range(6):
        info = env.reset(seed=seed)[1]
        model = env.episodes.arms.model_of(0)
        assert why_inside(model, env.episodes.arms.rows.q[0]) == ""
        drawn_numbers.add(tuple(info["drawn"].values()))
    # more than half of the draws would begin in the pillar
    assert len(drawn_numbers) > 1


def test_ranges_may_have_ends_at_which_gravity_bends_the_arm_into_an_obstacle():
    scene = {"scene": "paper_among_obstacles", "effects.gravity.acceleration": [0.0, 0.0, 0.0]}
    ranges = {"stiffness": [0.78, 1.22], "effects.gravity.acceleration": [[-5.7, 5.7]] * 3}
    softest = {
        "segments.0.young_modulus": 0.78e6,
        "effects.gravity.acceleration": [-5.7, -5.7, -5.7],
    }
    model = build_model(load_scene("paper_among_obstacles").replace(softest))
    rest = static_equilibrium(model, np.zeros(10), settle=True)
    assert "a box" in why_inside(model, rest.q)
    env = TipPoseEnv(scene=scene, fidelity="scene", randomize=ranges)
    env.reset(seed=0)
    assert why_inside(env.episodes.arms.model_of(0), env.episodes.arms.rows.q[0]) == ""


def test_ranges_whose_draws_obstacles_never_let_rest_are_refused():
    ranges = {"base.position": [0.0, [0.03, 0.032], 0.0]}
    with pytest.raises(ConfigurationError, match=r"21 in a row cannot begin at rest.* a sphere"):
        TipPoseEnv(
            scene={"scene": "three_tendon", "effects.contact.obstacles": [PILLAR]},
            fidelity="scene",
            randomize=ranges,
        )
