"""Saturated random actions for long: nothing raises, nothing is NaN; where no time step succeeds,
episodes end in order."""

import numpy as np
import pytest

from soft_tendon_env.effects import EFFECTS
from soft_tendon_env.envs import ReachVectorEnv, ShapeVectorEnv, TipPoseEnv, TipPoseVectorEnv
from soft_tendon_env.model.contact_forces import contact_forces

KINDS = (TipPoseVectorEnv, ShapeVectorEnv, ReachVectorEnv)
FIRST_IS_QUICK = [
    KINDS[0],
    *(pytest.param(kind, marks=pytest.mark.slow) for kind in KINDS[1:]),
]
DIVERGED = {"three_tendon": 0, "loaded": 0, "explicit": 0, "loads inside": 4}
"""Kinds of arms: the most episodes of which the arm may buckle, as soft ones do under the loads
inside."""
WILD = {
    "pushing": {"tension_limits": [-600.0, 0.0]},
    "pulling": {"tension_limits": [0.0, 3000.0]},
    "far too soft": {
        "randomize": {"stiffness": [0.01, 0.1], "payload": [0.0, 1.0], "density": [0.1, 10.0]}
    },
    "heavy errors": {
        "randomize": {
            "tension_gain": [0.0, 5.0],
            "tension_offset": [-100.0, 100.0],
            "latency": [0.0, 1.0],
        }
    },
    "few halvings": {
        "scene": {"scene": "paper", "integrator.max_halvings": 1},
        "fidelity": None,
        "tension_limits": [-100.0, 300.0],
    },
    "long periods": {"control_period": 2.5},
}
# Tendons that push or pull far past what the section holds, and no second try at smaller steps.
SATURATED = {
    "scene": {"scene": "three_tendon", "integrator.max_halvings": 0},
    "fidelity": None,
    "tension_limits": [-600.0, 600.0],
    "control_period": 0.05,
}


def saturate(vector, steps, seed=0):
    """Step with actions of -1 and 1, new at random times; counts of ended and of diverged
    episodes."""
    rng = np.random.default_rng(seed)
    vector.reset(seed=seed)
    ended = diverged = 0
    action = rng.choice([-1.0, 1.0], vector.action_space.shape)
    for _ in range(steps):
        change = rng.random(action.shape) < 0.3
        action = np.where(change, -action, action)
        observation, reward, terminated, truncated, info = vector.step(action)
        assert vector.observation_space.contains(observation)
        assert (reward >= 0.0).all()
        assert (reward <= 1.0).all()
        assert all(
            np.isfinite(values).all()
            for key, values in info.items()
            if key != "drawn" and values.dtype.kind == "f"
        )
        assert (info["diverged"] == terminated).all()
        ended = ended + int((terminated | truncated).sum())
        diverged = diverged + int(terminated.sum())
    return ended, diverged


@pytest.mark.parametrize("kind", FIRST_IS_QUICK)
def test_saturated_actions_at_the_limits_of_the_paper_s_arm(kind):
    assert saturate(
        kind(16, 60, fidelity="fast", action="tension", tension_limits=[0.0, 60.0]), 130
    ) == (32, 0)


@pytest.mark.parametrize(
    "name",
    [
        "explicit",
        *(
            pytest.param(name, marks=pytest.mark.slow)
            for name in ("three_tendon", "loaded", "loads inside")
        ),
    ],
)
@pytest.mark.parametrize("kind", FIRST_IS_QUICK)
def test_saturated_actions_on_random_arms(kind, name, arms, everything):
    options = {
        **arms[name],
        "action": "tension",
        "randomize": everything,
        "observation": "measurable",
        "sensors": [0.1, 0.3],
    }
    assert saturate(kind(16, 40, **options), 100)[1] <= DIVERGED[name]


@pytest.mark.parametrize(
    "how",
    [pytest.param(how, marks=[pytest.mark.slow] * (how in ("pushing", "pulling"))) for how in WILD],
)
def test_wild_arms_end_in_order(how):
    saturate(ShapeVectorEnv(4, 15, **{"fidelity": "fast", "action": "tension", **WILD[how]}), 20)


EVERY_EFFECT = {  # in fixed steps of 20 ms
    "scene": "three_tendon",
    "quadrature.intervals": 8,
    "integrator.step": 0.02,
    "effects.gravity.acceleration": [0.0, 0.0, -9.81],
    "effects.tip_load": {
        "force": [0.0, 0.02, 0.01],
        "moment": [0.0, 1e-3, 0.0],
        "mass": 0.005,
        "inertia": [1e-7, 1e-7, 1e-7],
    },
    "effects.fluid": {"density": 300.0, "current": [0.0, 0.2, 0.0]},
    "effects.disturbance.loads": [
        {"at": 0.2, "force": [0.0, 0.1, 0.0], "signal": {"type": "sine", "frequency": 2.0}},
        {
            "at": 0.25,
            "force": [0.0, 0.0, 0.1],
            "signal": {"type": "pulse", "start": 1.0, "duration": 0.3},
        },
    ],
    "effects.nonlinear_elasticity": {"bending": 10.0, "stretch": 0.1},
    "effects.viscoelastic_memory.branches": [
        {"modulus": 0.3, "relaxation_time": 0.2},
        {"modulus": 0.5, "relaxation_time": 0.005},
    ],
    "effects.contact": {
        "friction": 0.4,
        "obstacles": [
            {"type": "box", "position": [0.0, 0.0, -0.06], "size": [2.0, 2.0, 0.004]},
            {"type": "plane", "position": [0.0, 0.0, 0.1], "axis": [0.0, 0.0, -1.0]},
            {
                "type": "sphere",
                "position": [0.2, 0.12, 0.03],
                "radius": 0.04,
                "amplitude": [0.0, 0.05, 0.0],
                "frequency": 0.5,
            },
            {"type": "cylinder", "position": [0.25, -0.12, 0.0], "radius": 0.02, "length": 0.3},
        ],
    },
    "effects.moving_base": {
        "amplitude": [0.0, 0.005, 0.005],
        "angular_amplitude": 0.05,
        "frequency": 1.0,
    },
    "effects.actuators": {"time_constant": 0.02, "delay": 0.013},
    "effects.tendon_elasticity": {"stiffness": 5e3, "displacement_limits": [0.0, 0.02]},
    "effects.tendon_friction": {"coefficient": 0.15},
}


def live_among(steps, **options):
    """64 rows with every effect, in saturated actions: the deepest penetration [m], and the highest
    speed of a tip [m/s]."""
    ahead = {
        "type": "hold",
        "pose": [
            [1.0, 0.0, 0.0, 0.29],
            [0.0, 1.0, 0.0, 0.0],
            [0.0, 0.0, 1.0, 0.0],
            [0.0, 0.0, 0.0, 1.0],
        ],
    }
    vector = TipPoseVectorEnv(64, None, **options, observation=["tip_position"], target=ahead)
    assert {*vector.episodes.model.scene.effects.chosen()} == {
        name for name, effect in EFFECTS.items() if effect.__module__.startswith("soft_tendon_env.")
    }
    vector.reset(seed=0)
    rng = np.random.default_rng(0)
    deepest = 0.0
    fastest = 0.0
    touched = 0.0
    action = rng.choice([-1.0, 1.0], vector.action_space.shape)
    for step in range(steps):
        action = np.where(rng.random(action.shape) < 0.3, -action, action)
        observation, reward, terminated, _, _ = vector.step(action)
        assert np.isfinite(observation).all()
        assert np.isfinite(reward).all()
        assert not terminated.any()
        tip = vector.episodes.arms.reading
        assert np.isfinite(tip.tip_pose).all()
        assert np.isfinite(vector.episodes.arms.rows.state).all()
        assert (tip.tip_pose[:, 2, 3] > -0.06).all(), "on this side of plate and wall"
        assert (tip.tip_pose[:, 2, 3] < 0.1).all(), "on this side of plate and wall"
        fastest = max(fastest, np.linalg.norm(tip.tip_twist[:, 3:], axis=1).max())
        found = contact_forces(vector.model, vector.episodes.state(step % 64))
        deepest = max(deepest, found.penetration.max())
        touched = touched + float(found.sample_force.any())
    assert touched > 0.05 * steps
    vector.close()
    return deepest, fastest


@pytest.mark.slow
def test_every_effect_at_once():
    """Nobody sinks in by half of the radius, nor flies off."""
    deepest, fastest = live_among(150, scene=EVERY_EFFECT, fidelity="scene")
    assert deepest < 0.005
    assert fastest < 10.0


def test_a_divergence_ends_the_episode():
    env = TipPoseEnv(**SATURATED)
    env.reset(seed=0)
    rng = np.random.default_rng(0)
    steps = 0
    terminated = False
    truncated = False
    while not (terminated or truncated):
        observation, reward, terminated, truncated, info = env.step(
            rng.choice([-1.0, 1.0], env.action_space.shape)
        )
        steps += 1
        assert steps < 200, "nothing diverged"
    assert (terminated, truncated) == (True, False)
    assert reward == 0.0
    assert info["diverged"] is True
    assert isinstance(info["cause"], str)
    assert info["cause"]
    assert env.observation_space.contains(observation)
    assert np.isfinite(observation).all()
    assert all(np.isfinite(value) for value in info.values() if not isinstance(value, str))
    observation, info = env.reset()
    assert info["diverged"] is False
    assert "cause" not in info


@pytest.mark.parametrize("mode", ["next_step", "same_step"])
def test_other_rows_go_on(mode, same):
    """Rows 0 and 2 are gentle, row 1 is not: the gentle ones are as alone."""
    vector = TipPoseVectorEnv(3, None, mode, **SATURATED)
    alone = TipPoseEnv(**SATURATED)
    vector.reset(seed=3)
    alone.reset(seed=5)
    rng = np.random.default_rng(0)
    ends = 0
    for _ in range(60):
        action = 0.001 * rng.uniform(-1, 1, (3, 3))
        action[1] = rng.choice([-1.0, 1.0], 3)
        observation, reward, terminated, truncated, info = vector.step(action)
        expected = alone.step(action[2])
        assert same(observation[2], expected[0])
        assert reward[2] == expected[1]
        assert not terminated[[0, 2]].any()
        assert not truncated.any()
        if terminated[1]:
            ends += 1
            if mode == "same_step":
                final = info["final_info"]
            else:
                final = info
            assert reward[1] == 0.0
            assert final["diverged"].tolist() == [False, True, False]
            assert isinstance(final["cause"][1], str)
            assert final["_cause"].tolist() == [
                False,
                True,
                False,
            ]
    assert ends > 1


def test_an_episode_whose_tip_is_too_fast_ends_as_one_that_diverged():
    """At the first step at which it is faster, and with the speed in its cause; without a limit it
    goes on."""
    options = {"scene": "three_tendon", "fidelity": "fast", "observation": ["tip_twist"]}
    pull = np.array([1.0, -1.0, -1.0], dtype=np.float32)

    def speeds(**more):
        env = TipPoseEnv(**options, **more)
        env.reset(seed=0)
        found = []
        for _ in range(20):
            _, reward, terminated, _, info = env.step(pull)
            found.append(float(np.linalg.norm(env.episodes.arms.reading.tip_twist[0, 3:])))
            if terminated:
                return found, reward, info
        return found, None, None

    free, _, ended = speeds()
    assert ended is None
    limit = 0.5 * (free[0] + max(free))
    found, reward, info = speeds(tip_speed_limit=limit)
    assert found == free[: len(found)]
    assert found[-1] > limit >= max(found[:-1])
    assert reward == 0.0
    assert info["diverged"]
    assert f"tip_speed_limit is {limit:g}" in info["cause"]
