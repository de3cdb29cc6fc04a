"""What holds for every effect of the package: order in time, states that continue, rows like
simulations, hard inputs, configuration."""

import json
from typing import ClassVar

import numpy as np
import pytest

from soft_tendon_env import ConfigurationError, Simulation, State, load_scene, register, simulate
from soft_tendon_env.effects import EFFECTS, Effect, Struct
from soft_tendon_env.envs.arms import Arms
from soft_tendon_env.model.build import build_model
from soft_tendon_env.scene.scene import Scene, scene_to_dict

GRAVITY = {"effects.gravity.acceleration": [9.81, 0.0, 0.0]}
CASES = {
    "gravity": GRAVITY,
    "tip_load": {
        "effects.tip_load": {"force": [0.0, 0.02, 0.01], "moment": [0.0, 1e-3, 0.0], "mass": 0.005}
    },
    "fluid": {**GRAVITY, "effects.fluid": {"density": 1000.0, "current": [0.1, 0.3, 0.2]}},
    "disturbance": {
        "effects.disturbance.loads": [
            {
                "at": 0.2,
                "force": [0.0, 0.05, 0.0],
                "signal": {"type": "sine", "frequency": 2.0, "phase": 30.0},
            },
            {
                "at": 0.15,
                "force": [0.0, 0.0, 0.02],
                "signal": {"type": "pulse", "start": 0.1, "duration": 0.06},
            },
        ]
    },
    "nonlinear_elasticity": {"effects.nonlinear_elasticity": {"bending": 5.0, "stretch": 0.05}},
    "viscoelastic_memory": {
        "effects.viscoelastic_memory.branches": [
            {"modulus": 0.5, "relaxation_time": 0.1},
            {"modulus": 1.0, "relaxation_time": 0.005},
        ]
    },
    "contact": {
        "effects.contact.obstacles": [
            {"type": "plane", "position": [0.0, 0.0, -0.02], "axis": [0.0, 0.1, 1.0]}
        ]
    },
    "actuators": {
        "effects.actuators": {"time_constant": 0.05, "rate_limit": 100.0, "delay": 0.013}
    },
    "tendon_elasticity": {
        "effects.tendon_elasticity": {"stiffness": 500.0, "displacement_limits": [0.0, 0.01]}
    },
    "tendon_friction": {"effects.tendon_friction": {"coefficient": 0.2, "stiction_speed": 1e-2}},
    "moving_base": {
        "effects.moving_base": {
            "amplitude": [0.0, 0.01, 0.0],
            "angular_amplitude": 0.2,
            "frequency": 2.0,
        }
    },
}
"""For every effect, changes of a scene that give it."""
UNITS = {"tendon_elasticity": 2e-3}
"""Commands that take the place of 1 N."""
COARSE = {"tendon_elasticity": 3e-3}
"""Error [m] at 20 ms of what steps so long do not extrapolate, see `complete_row` in
mechanics/motion/extrapolation.py."""
HELD = {"tendon_elasticity": 0.02}
"""Commands that leave smooth what begins and ends otherwise, as slack does."""


PULSE = {"type": "pulse", "start": 0.0, "duration": 1}
MISTAKES = [
    # effect, its table, the message
    ("gravity", 3, "effects.gravity is 3: it should be a table"),
    ("gravity", {"acceleration": [0.0, 0.0]}, r"effects\.gravity\.acceleration"),
    ("magnetism", {"field": 1.0}, "effects.magnetism is an unknown key"),
    ("contact", {"obstacles": [{"type": "cone", "position": [0, 0, 0]}]}, "type is 'cone'"),
    (
        "contact",
        {"obstacles": [{"type": "plane", "position": [0, 0, 0], "axis": [0, 0, 0]}]},
        "should be a direction",
    ),
    (
        "disturbance",
        {"loads": [{"force": [0, 0, 1]}]},
        r"effects.disturbance.loads\[0\].at is missing",
    ),
    (
        "disturbance",
        {"loads": [{"at": 0.4}]},
        r"effects.disturbance.loads\[0\].at is 0.4 m: the rod has 0.3 m",
    ),
    (
        "disturbance",
        {"loads": [{"at": 0.1, "signal": PULSE}]},
        r"signal.start is 0.0: .*greater than 0",
    ),
    ("moving_base", {"axis": [0.0, 0.0, 0.0]}, "axis .* should be a direction"),
    ("moving_base", {"amplitude": [0.1, 0.0, 0.0]}, "frequency should be above 0 Hz"),
    (
        "tendon_elasticity",
        {"displacement_limits": [0.0, 0.1], "stiffness": [1e3, 1e3]},
        r"effects\.tendon_elasticity",
    ),
    (
        "tendon_elasticity",
        {"displacement_limits": [0, 1], "stiffness": 1e3, "slack": [0.0]},
        "has 1 entries: .* for each tendon, 3",
    ),
    (
        "tendon_elasticity",
        {"displacement_limits": [0.1, 0.0], "stiffness": 1e3},
        r"effects\.tendon_elasticity",
    ),
]


def test_every_effect_is_tried_here():
    assert {
        name for name, effect in EFFECTS.items() if effect.__module__.startswith("soft_tendon_env.")
    } == set(CASES)


@pytest.mark.parametrize(("name", "table", "message"), MISTAKES)
def test_mistakes_are_named(build, name, table, message):
    with pytest.raises(ConfigurationError, match=message):
        build_model(build("three_tendon").scene.replace({f"effects.{name}": table}))


def values_of(state: State) -> list:
    return [state.time, state.q, state.q_dot, state.strain, state.step, state.effects]


@pytest.mark.parametrize(
    "name", sorted({*CASES} - {"contact"})
)  # which begins and ends within steps, see test_contact.py
def test_order_in_time(name, uniform):
    """Third order with three columns, at steps from 20 to 0.6 ms, beside which memory is fast and
    slow, for a bent arm that is let go."""

    def tip(step, columns):
        model = uniform(
            changes={
                "quadrature.intervals": 6,
                "integrator.step": step,
                "integrator.columns": columns,
                **CASES[name],
            }
        )
        start = Simulation(model).reset([3.0, -2.0], [0.5, 1.0])
        return simulate(model, np.full(3, HELD.get(name, 0.0)), 0.4, 0.02, initial=start).tip_pose[
            -1, :3, 3
        ]

    exact = tip(3e-4, 4)
    steps = 0.02 * 0.5 ** np.arange(6)
    errors = np.array([np.abs(tip(step, 3) - exact).max() for step in steps])
    assert np.polyfit(np.log(steps), np.log(errors), 1)[0] > 2.5
    assert errors[0] < COARSE.get(name, 1e-4), "[m], of 0.3 m"
    assert errors[-1] < 3e-9, "[m], of 0.3 m"


@pytest.mark.parametrize("name", CASES)
def test_a_saved_state_continues_bit_for_bit(name, build, tmp_path):
    model = build("three_tendon", CASES[name])
    simulation = Simulation(model)
    unit = UNITS.get(name, 1.0)
    simulation.step(unit * np.array([3.0, 0.0, 1.0]), 0.1)
    simulation.state.save(tmp_path / "state.npz")
    other = Simulation(model, State.load(tmp_path / "state.npz"))
    np.testing.assert_array_equal(other.tip_pose, simulation.tip_pose)
    for one in (simulation, other):
        one.step(unit * np.array([0.0, 2.0, 1.0]), 0.1)
    np.testing.assert_array_equal(other.tip_pose, simulation.tip_pose)
    for found, expected in zip(values_of(other.state), values_of(simulation.state), strict=True):
        np.testing.assert_array_equal(found, expected)


@pytest.mark.parametrize("name", CASES)
def test_rows_are_like_simulations(name, build):
    """Also a row of another material, as a simulation of a scene of that material is, to
    round-off."""
    segment = build("three_tendon").scene.segments[0]
    factors = {"young_modulus": 1.5, "damping": 0.8, "density": 0.9}
    other = {f"segments.0.{key}": factor * getattr(segment, key) for key, factor in factors.items()}
    modes = [{"strains": ["bend_y", "bend_z"], "order": 1, "span": "rod"}]
    changes = {"quadrature.intervals": 6, "strain": {"type": "explicit", "modes": modes}}
    models = [build("three_tendon", {**changes, **CASES[name], **more}) for more in ({}, other)]
    arms = Arms(models[0], 3, 0.02, np.array([0.3]), np.array([0.1]), 1)
    arms.set_model(2, models[0].with_numbers(other))
    arms.place(np.arange(3), np.zeros((3, models[0].coordinate_count)))
    simulations = [Simulation(models[i]) for i in (0, 0, 1)]
    rng = np.random.default_rng(0)
    for _ in range(10):
        tension = UNITS.get(name, 1.0) * rng.uniform(0.0, 3.0, (3, 1, 3))
        arms.step(tension, np.arange(3))
        for simulation, u in zip(simulations, tension[:, 0], strict=True):
            simulation.step(u, 0.02)
    for row, simulation in enumerate(simulations):
        state = simulation.state
        tolerance = 1e-12 if row < 2 else 1e-9
        for found, expected in (
            (arms.rows.q, state.q),
            (arms.rows.q_dot, state.q_dot),
            (arms.rows.state, state.effects),
        ):
            np.testing.assert_allclose(found[row], expected, rtol=tolerance, atol=tolerance)


@pytest.mark.parametrize("name", CASES)
def test_configuration_survives_a_round_trip_and_covers_its_variations(name, build):
    scene = build("three_tendon").scene.replace(CASES[name])
    table = json.loads(json.dumps(scene_to_dict(scene)))
    assert Scene(**table) == scene
    rng = np.random.default_rng(0)
    for _ in range(20):
        varied = scene.effects.sample_smaller(rng)
        assert scene.effects.includes(varied)
    build_model(
        scene.replace(
            {
                "effects": scene_to_dict(
                    scene.replace({"effects": varied.model_dump(exclude_none=True)})
                )["effects"]
            }
        )
    )


@pytest.mark.parametrize(
    ("name", "table", "message"),
    [
        (
            "contact",
            {"obstacles": [{"type": "plane", "position": [0, 0, -1], "velocity": [0, 0, 1]}]},
            "obstacles that move has no pot",
        ),
        (
            "disturbance",
            {"loads": [{"at": 0.3, "moment": [0, 0, 1]}]},
            "the effect Disturbance has no potential energy",
        ),
        (
            "fluid",
            {"density": 1000.0, "current": [0.0, 0.0, 1.0]},
            "a fluid that streams has no potential energy",
        ),
        (
            "moving_base",
            {"velocity": [1.0, 0.0, 0.0]},
            "the effect MovingBase has no potential energy",
        ),
        (
            "tip_load",
            {"moment": [0.0, 0.1, 0.0]},
            "a tip load with a moment, .* has no potential energy",
        ),
        (
            "tip_load",
            {"force": [0.0, 0.0, 1.0], "frame": "tip"},
            "a tip load .* that follows the tip, has no potential energy",
        ),
    ],
)
def test_what_has_no_potential_energy_says_so(build, name, table, message):
    with pytest.raises(ValueError, match=message):
        build("three_tendon", {"quadrature.intervals": 2, f"effects.{name}": table}).energy(
            np.zeros(3), np.zeros(3)
        )


@pytest.mark.parametrize(
    ("numbers", "message"),
    [
        ({"gain": 2.0}, r"gain = 2.0: it may give lags \(int\), "),
        ({"delay": 1}, r"delay = 1: .* delay \(float\)"),
    ],
)
def test_what_no_kernel_reads_of_a_transmission_is_refused(forgotten, numbers, message):
    @register("effect", "gear")
    class Gear(Effect):
        is_actuation: ClassVar[bool] = True

        def transmission(self, rod):
            return numbers

    with pytest.raises(TypeError, match=f"Gear.transmission gives {message}"):
        build_model(load_scene("three_tendon").replace({"effects.gear": {}}))


def test_an_effect_says_itself_how_strong_it_is(forgotten):
    @register("effect", "wind")
    class Wind(Effect):
        strengths: ClassVar[tuple[str, ...]] = ("speed",)

        speed: float

        def parameters(self, rod):
            return Struct()

    effects = load_scene("three_tendon").replace({"effects.wind.speed": 2.0}).effects
    weaker = effects.sample_smaller(np.random.default_rng(0))
    assert 0.0 < weaker.wind.speed < 2.0
    assert effects.includes(weaker)
    assert not weaker.includes(effects)
