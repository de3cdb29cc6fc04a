"""Bad input of models, simulations and states is named and changes nothing; commands beyond their
limits get a word."""

import contextlib
import dataclasses
import warnings

import numpy as np
import pytest

import soft_tendon_env as ste
from soft_tendon_env.model.state import SAME_STRAIN
from soft_tendon_env.model.statics import static_equilibrium
from soft_tendon_env.model.tension_limits import TensionLimitWarning, erring_actuators

OK = np.zeros(10)
BAD = np.full(10, float("nan"))
MEMORY = {"effects.viscoelastic_memory.branches": [{"modulus": 0.4, "relaxation_time": 0.05}]}
SLOWER = {"effects.viscoelastic_memory.branches": [{"modulus": 0.4, "relaxation_time": 0.5}]}
BEND_Y = {"type": "explicit", "modes": [{"strains": ["bend_y"], "order": 1, "span": "rod"}]}
BEND_Z = {"type": "explicit", "modes": [{"strains": ["bend_z"], "order": 1, "span": "rod"}]}
LATE = {"effects.tendon_elasticity": {"stiffness": 2000.0, "displacement_limits": [0.0, 0.02]}}
WAYS = {
    "simulate": lambda model, u: ste.simulate(model, u, 0.04, 0.02, ste.Simulation(model).state),
    "step": lambda model, u: ste.Simulation(model).step(u, 0.02),
    "rollout": lambda model, u: ste.Simulation(model).rollout([u], 0.02),
    "linearize": lambda model, u: ste.Simulation(model).linearize(u, 0.02),
    "commanded_equilibrium": ste.commanded_equilibrium,
}


@pytest.fixture
def moving(build):
    """A simulation of the paper's arm in mid-run."""
    model = build("paper")
    simulation = ste.Simulation(model)
    simulation.step(np.linspace(0.0, 9.0, 10), 0.05)
    return simulation


def numbers(simulation):
    state = simulation.state
    return (
        state.time,
        state.step,
        state.q.tobytes(),
        state.q_dot.tobytes(),
        state.strain.tobytes(),
    )


def set_state(simulation, **changes):
    simulation.state = dataclasses.replace(simulation.state, **changes)


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda s: s.model.terms(OK, OK, BAD), "tension should be finite"),
        (lambda s: static_equilibrium(s.model, BAD), "tension should be finite"),
        (lambda s: s.reset(BAD), "q should be finite"),
        (lambda s: s.step(BAD, 0.01), "command should be finite"),
        (lambda s: s.step(OK, -0.1), "duration should be"),
        (lambda s: s.step(OK, 1e12), "duration should be at most"),
        (lambda s: set_state(s, q=BAD), "state.q should be finite"),
        (lambda s: set_state(s, strain=BAD), "state.strain should have shape"),
        (
            lambda s: set_state(s, q=s.state.q + 1.0),
            "state.strain",
        ),  # the strain is that of other coordinates
        (lambda s: set_state(s, step=0.0), "state.step"),
        (lambda s: ste.simulate(s.model, OK, 0.35, 0.1, s.state), "duration should be a multiple"),
        (lambda s: ste.simulate(s.model, OK, 1.0, -0.1, s.state), "sample_period"),
        (
            lambda s: ste.simulate(s.model, np.zeros((9, 10)), 1.0, 0.1),
            "command should have shape (10, 10)",
        ),
        (
            lambda s: ste.simulate(s.model, lambda t: OK if t < 0.55 else BAD, 1.0, 0.1),
            "command(0.55)[0]",
        ),
        (lambda s: ste.simulate(s.model, OK, 1.0, 0.1, initial=3), "state should be a State"),
        (lambda s: ste.Simulation(s.model.scene), "model should be a Model"),
        (lambda s: static_equilibrium(s.model.scene, OK), "model should be a Model"),
        (lambda s: ste.commanded_equilibrium(s.model.scene, OK), "model should be a Model"),
        (lambda s: ste.tension_for_tip_pose(s.model.scene, np.eye(4)), "model should be a Model"),
        (lambda s: ste.tension_for_tip_position(s.model.scene, OK[:3]), "model should be a Model"),
        (lambda s: ste.build_model("paper"), "scene should be a Scene"),
        (lambda s: ste.build_model(s.model.scene, fidelity="exact"), "fidelity"),
        (
            lambda s: ste.load_scene(3),
            "name_or_path should be the name of a shipped scene or the path of a TOML file, not",
        ),
        (lambda s: ste.save_scene(3, "never.toml"), "scene should be a Scene"),
        (lambda s: s.model.scene.replace({3: 1}), "changes has the key 3: keys should be strings"),
        (
            lambda s: s.model.scene.replace({"integrator.tolerance": 1e-16}),
            "integrator.tolerance is 1e-16: it should be at least",
        ),
    ],
)
def test_bad_input_is_named_and_changes_nothing(moving, call, message):
    before = numbers(moving)
    with pytest.raises((ValueError, TypeError)) as caught:
        call(moving)
    assert message in str(caught.value)
    assert numbers(moving) == before


@pytest.mark.parametrize(("share", "is_same"), [(0.5, True), (3.0, False)])
def test_a_strain_is_that_of_its_coordinates_up_to_round_off(moving, share, is_same):
    """As a share of the largest, also beside a strain that is none."""
    strain = moving.state.strain.copy()
    largest_strain = np.abs(strain).max()
    assert np.abs(strain).min() < 1e-3 * largest_strain
    off = share * SAME_STRAIN * np.abs(strain).max()
    row = np.unravel_index(np.abs(strain).argmin(), strain.shape)
    strain[row] += off
    refused = pytest.raises(ValueError, match="should be the strain at state.q")
    with contextlib.nullcontext() if is_same else refused:
        set_state(moving, strain=strain)


@pytest.mark.parametrize(
    ("theirs", "ours", "message"),
    [
        ({"quadrature.intervals": 4}, {"quadrature.intervals": 6}, "state.strain"),
        ({"strain.passive": [{"strains": ["bend_y"], "order": 3, "span": "rod"}]}, {}, "state.q "),
        ({"strain": BEND_Y}, {"strain": BEND_Z}, "state.strain"),
        (MEMORY, {}, "this state is of viscoelastic_memory:96"),
        ({}, MEMORY, "this state is of no effects with states"),
        (
            MEMORY,
            SLOWER,
            (
                "relaxation times [0.5] s; this state is of viscoelastic_memory:96 + relaxation"
                " times [0.05] s"
            ),
        ),
    ],
)
def test_states_of_another_arm_are_refused(build, tmp_path, theirs, ours, message):
    """As many numbers of another meaning would be read as this arm's; from a file too."""
    model = build("four_tendon", theirs)
    stranger = ste.Simulation(model)
    arm = ste.Simulation(build("four_tendon", ours))
    stranger.reset(np.full(stranger.model.coordinate_count, 0.1))
    before = numbers(arm)
    stranger.state.save(tmp_path / "state.npz")
    for state in (stranger.state, ste.State.load(tmp_path / "state.npz")):
        for call in (
            lambda s=state: setattr(arm, "state", s),
            lambda s=state: ste.simulate(arm.model, np.zeros(4), 0.1, 0.1, s),
        ):
            with pytest.raises(ValueError) as caught:
                call()
            assert message in str(caught.value)
            assert numbers(arm) == before


def test_files_that_hold_no_state_are_refused(moving, tmp_path):
    path = tmp_path / "state.npz"
    moving.state.save(path)
    whole = path.read_bytes()
    for content in (b"", b"no archive", whole[: len(whole) // 2], whole[:-1]):
        path.write_bytes(content)
        with pytest.raises(ValueError, match=str(path)):
            ste.State.load(path)
    for changes in (
        {"q": np.array([None, "q"])},
        {"time": np.zeros(3)},
        {"step": np.array("soon")},
    ):
        np.savez(path, **{**dataclasses.asdict(moving.state), **changes})
        with pytest.raises(ValueError, match="holds no state"):
            ste.State.load(path)


def said(way, model, command):
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        way(model, command)
    return [str(warning.message) for warning in caught if warning.category is TensionLimitWarning]


@pytest.mark.parametrize("name", WAYS)
def test_what_goes_beyond_is_said_once(build, name):
    way = WAYS[name]
    model = build("three_tendon")
    almost = 5.0 * (1.0 + 1e-12)
    assert said(way, model, [almost, 0.0, 2.0]) == []
    for command in ([0.0, 5.2, 0.0], [0.0, -0.1, 6.0]):
        (text,) = said(way, model, command)
        assert text.startswith(
            "tendons[1] goes beyond its tension_limits, 0 to 5 N: computed as asked"
        )
    with erring_actuators():
        assert said(way, model, [0.0, 5.2, 0.0]) == []
    assert len(said(way, model, [0.0, 5.2, 0.0])) == 1


@pytest.mark.parametrize("name", WAYS)
def test_commands_that_are_displacements_have_limits_of_their_own(build, name):
    model = build("three_tendon", LATE)
    assert said(WAYS[name], model, [0.001, 0.0, 0.0]) == []
    (text,) = said(WAYS[name], model, [0.0, 0.0, 0.025])
    assert text.startswith("tendons[2] goes beyond its tension_limits, 0 to 0.02 m")
