"""Bad input at every public door.

NaN passes comparisons, numpy broadcasts wrong shapes, strings become arrays: what is not refused at the door fails far away from it, or
not at all. Whoever catches the error must find everything as it was.
"""

import dataclasses
import io
import pickle
import warnings
import zipfile

import gymnasium as gym
import numpy as np
import pytest

import soft_tendon_env as ste
from soft_tendon_env.model.contact_forces import contact_forces
from soft_tendon_env.model.statics import static_equilibrium, static_stiffness
from soft_tendon_env.scene.artifacts.passive_fields import FieldsWarning

NAN, INF = float("nan"), float("inf")


def vector(entry, at=3, size=10):
    values = np.zeros(size)
    values[at] = entry
    return values


BAD_VECTORS = {
    "nan": (vector(NAN), ValueError), "inf": (vector(INF), ValueError), "-inf": (vector(-INF), ValueError),
    "short": (np.zeros(9), ValueError),
    "long": (np.zeros(11), ValueError), "number": (1.0, ValueError), "matrix": (np.zeros((7, 10)), ValueError), "empty": ([], ValueError),
    "three axes": (np.zeros((1, 1, 10)), ValueError), "text": ("0123456789", TypeError), "texts": (["0"] * 10, TypeError),
    "complex": (np.zeros(10, complex), TypeError), "bool": (np.zeros(10, bool), TypeError), "objects": ([None] * 10, TypeError),
}  # fmt: skip
BAD_DURATIONS = {
    "nan": (NAN, ValueError), "inf": (INF, ValueError), "negative": (-0.1, ValueError),
    "text": ("0.1", TypeError), "none": (None, TypeError),
    "bool": (True, TypeError), "array": (np.array([0.1, 0.2]), TypeError), "list": ([0.1], TypeError), "complex": (0.1j, TypeError),
}  # fmt: skip


@pytest.fixture
def moving(build):
    """A simulation in mid-run."""
    simulation = ste.Simulation(build("paper"))
    simulation.step(np.linspace(0.0, 9.0, 10), 0.05)
    return simulation


def bits(simulation):
    state = simulation.state
    return (state.time, state.step, state.q.tobytes(), state.q_dot.tobytes(), state.strain.tobytes())


def refuse(simulation, kind, name, call):
    """Asserts that the call raises `kind` (ValueError or TypeError) naming the argument, and leaves the simulation as it was."""
    before = bits(simulation)
    with pytest.raises(kind) as caught:
        call()
    assert name in str(caught.value), str(caught.value)
    assert bits(simulation) == before
    return 1


@pytest.mark.cases("bad", BAD_VECTORS)
def test_vectors(build, moving, measured, bad):
    """NaN, infinities, wrong shapes and types as coordinates, rates and tensions.
    Expected: ValueError or TypeError that names the argument, at every door, and nothing has changed.
    """
    model, ok, (value, kind) = moving.model, np.zeros(10), BAD_VECTORS[bad]
    doors = [
        ("q", lambda: model.terms(value, ok)), ("q_dot", lambda: model.terms(ok, value)), ("tension", lambda: model.terms(ok, ok, value)),
        ("q", lambda: model.tip_pose(value)), ("q", lambda: model.backbone(value)), ("q", lambda: model.backbone_at(value, [0.5])),
        ("q", lambda: model.strain(value)), ("q", lambda: model.tendon_lengths(value)),
        ("q", lambda: model.energy(value, ok)), ("q_dot", lambda: model.energy(ok, value)),
        ("tension", lambda: model.rest_coordinates(value)),
        ("tension", lambda: static_equilibrium(model, value)), ("q", lambda: static_stiffness(model, value, ok)),
        ("tension", lambda: static_stiffness(model, ok, value)), ("q", lambda: moving.reset(value)),
        ("q_dot", lambda: moving.reset(ok, value)),
        ("command", lambda: moving.step(value, 0.01)), ("command", lambda: ste.simulate(model, value, 1.0, 0.1, moving.state)),
        ("command(", lambda: ste.simulate(model, lambda t: value if t > 0.5 else ok, 1.0, 0.1, moving.state)),
        ("state.q", lambda: setattr(moving, "state", dataclasses.replace(moving.state, q=value))),
        ("state.q_dot", lambda: setattr(moving, "state", dataclasses.replace(moving.state, q_dot=value))),
        ("state.strain", lambda: setattr(moving, "state", dataclasses.replace(moving.state, strain=value))),
    ]  # fmt: skip
    refused = sum(refuse(moving, kind, name, call) for name, call in doors)
    measured("doors", refused)


@pytest.mark.cases("bad", BAD_DURATIONS)
def test_durations(moving, measured, bad):
    """NaN, infinity, negative numbers and other types as durations and sample periods.
    Expected: ValueError or TypeError that names the argument; nothing has changed.
    """
    model, ok, (value, kind) = moving.model, np.zeros(10), BAD_DURATIONS[bad]
    doors = [
        ("duration", lambda: moving.step(ok, value)),
        ("duration", lambda: ste.simulate(model, ok, value, 0.1, moving.state)),
        ("sample_period", lambda: ste.simulate(model, ok, 1.0, value, moving.state)),
        ("state.step", lambda: setattr(moving, "state", dataclasses.replace(moving.state, step=value))),
    ]
    if bad != "negative":
        doors.append(("state.time", lambda: setattr(moving, "state", dataclasses.replace(moving.state, time=value))))
    known = 2 if bad != "negative" else 1  # state.step and state.time have their own case below: test_state_is_taken_whole
    measured("doors", sum(refuse(moving, kind, name, call) for name, call in doors[:-known]))
    for name, call in doors[-known:]:
        with pytest.raises(kind, match=name.replace(".", r"\.")):
            call()


@pytest.mark.parametrize("scene, step", [("paper", 0.02), ("three_tendon", 1e-3), ("paper_48dof", 1e-7)])
@pytest.mark.parametrize("duration", [1e12, 1e302])
def test_durations_beyond_memory(build, measured, scene, step, duration):
    """Durations, sample periods and steps of which the samples or the tensions would fill the memory, or of which the count overflows.
    Expected: ValueError at once that names the argument and says how much one call may take; nothing has changed.
    """
    simulation = ste.Simulation(build(scene, {"integrator.step": step}))
    model, ok = simulation.model, np.zeros(simulation.model.tendon_count)
    doors = [
        ("duration should be at most", lambda: simulation.step(ok, duration)),
        ("duration should be at most", lambda: ste.simulate(model, ok, duration, 10.0 * step)),
        ("sample_period should be at most", lambda: ste.simulate(model, ok, duration, duration)),
        ("duration should be at most", lambda: ste.simulate(model, lambda t: ok, duration, 1e-12)),
        ("duration should be at most", lambda: ste.simulate(model, np.zeros((3, ok.size)), duration, step, simulation.state)),
    ]
    measured("doors", sum(refuse(simulation, ValueError, name, call) for name, call in doors))


def test_the_longest_duration_is_the_one_that_is_told(build):
    """What the message allows, for an arm of which a sample and its tensions are many numbers.
    Expected: taken to be checked further when it is no longer, refused when it is.
    """
    model = build("paper_48dof", {"integrator.step": 1.0})
    with pytest.raises(ValueError, match="at most") as caught:
        ste.simulate(model, np.zeros(10), 1e9, 1.0)
    longest = float(str(caught.value).split("at most ")[1].split(" s")[0])
    wrong = np.zeros((2, 10))
    with pytest.raises(ValueError, match="command should have shape"):
        ste.simulate(model, wrong, float(np.floor(0.999 * longest)), 1.0)
    with pytest.raises(ValueError, match="duration should be at most"):
        ste.simulate(model, wrong, float(np.ceil(1.001 * longest)), 1.0)


@pytest.mark.cases("scene", ["paper", "three_tendon", "catheter", "helical"])
@pytest.mark.cases("tolerance", [1e-12, 1e-16, 1e-300])
def test_tolerances_below_round_off(build, scene, tolerance):
    """An error per step that no step can be shown to keep: all of them are rejected, or a million of them are taken.
    Expected: ConfigurationError that names the key, the value and the least that is allowed.
    """
    found = ste.load_scene(scene)
    with pytest.raises(ste.ConfigurationError, match=rf"^scene: integrator\.tolerance is {tolerance:g}: it should be at least .* m,"):
        found.replace({"integrator.tolerance": tolerance})


@pytest.mark.parametrize("scene", ["paper", "three_tendon", "catheter"])
def test_tolerances_that_steps_do_not_meet(build, scene):
    """A tolerance for which the step may not be halved often enough.
    Expected: SimulationDiverged that names the tolerance and the smallest step; with more columns and halvings it is met.
    """
    changes = {"integrator.tolerance": 1e-10, "integrator.columns": 3, "integrator.max_halvings": 4}
    model = build(scene, changes)
    pull = np.array([0.3 * tendon.tension_limits[1] for tendon in model.scene.tendons]) * (np.arange(model.tendon_count) == 0)
    with pytest.raises(ste.SimulationDiverged, match=r"above integrator\.tolerance, 1e-10 m, even with steps of .* s, 4 halvings"):
        ste.Simulation(model).step(pull, 0.02)
    patient = build(scene, {**changes, "integrator.max_halvings": 20, "integrator.columns": 6})
    report = ste.Simulation(patient).step(pull, 0.02)
    assert 0.0 < report.error <= 1e-10 * report.steps


def test_state_is_taken_whole(moving):
    """A state of which the last field is bad: the fields before it have been taken already.
    Expected: ValueError, and q, q_dot, strain and time are what they were.
    """
    other = ste.Simulation(moving.model)
    other.step(np.full(10, 5.0), 0.03)
    for bad in ({"time": NAN}, {"step": -1.0}, {"step": NAN}):
        refuse(moving, ValueError, "state.", lambda bad=bad: setattr(moving, "state", dataclasses.replace(other.state, **bad)))


def test_state_with_step_zero(moving, build):
    """With error control a step of 0 s takes forever: it never grows, and time stands still.
    Expected: ValueError that names state.step.
    """
    for simulation in (moving, ste.Simulation(build("paper", {"integrator.tolerance": 1e-5}))):
        refuse(simulation, ValueError, "state.step", lambda s=simulation: setattr(s, "state", dataclasses.replace(s.state, step=0.0)))


def test_states_of_other_models(build, moving):
    """States of a model with other coordinates, or with as many coordinates but other quadrature points.
    Expected: ValueError that names the first field that does not fit; nothing has changed.
    """
    strangers = (("four_tendon", {}, "state.q "), ("paper_16dof", {}, "state.q "), ("paper", {"quadrature.intervals": 12}, "state.strain"))
    for name, changes, field in strangers:
        stranger = ste.Simulation(build(name, changes)).state
        refuse(moving, ValueError, field, lambda stranger=stranger: setattr(moving, "state", stranger))
        refuse(moving, ValueError, field, lambda stranger=stranger: ste.Simulation(moving.model, stranger))
        refuse(moving, ValueError, field, lambda stranger=stranger: ste.simulate(moving.model, np.zeros(10), 1.0, 0.1, stranger))


def test_states_of_other_effects_of_the_same_size(build, measured, tmp_path):
    """Internal states of as many numbers: friction's directions of sliding become tensions, strains of one damper those of another.
    Expected: ValueError that names both, from every door and from a file, a file without names too; nothing has changed.
    """
    memory, swapped = ([{"modulus": 0.4, "relaxation_time": time} for time in times] for times in ([0.05, 2.0], [2.0, 0.05]))
    plane, box = {"type": "plane", "position": [0.0, 0.0, -0.02]}, {"type": "box", "position": [0.0, 0.0, -0.03], "size": [1.0, 1.0, 0.02]}
    actuators, elasticity = {"time_constant": 0.2}, {"stiffness": 2e3, "displacement_limits": [0.0, 0.01]}
    order = {"strain": {"type": "explicit", "modes": [{"strains": ["bend_y"], "order": 1, "span": "rod"}]}}
    other = {"strain": {"type": "explicit", "modes": [{"strains": ["bend_z"], "order": 1, "span": "rod"}]}}
    lag = {"effects.actuators": actuators}
    pairs = [  # what the state is of, the arm's own, what the message names
        ({"effects.tendon_friction": {"coefficient": 0.2}}, lag, "tendon_friction:8"),
        ({**lag, "effects.tendon_elasticity": elasticity}, lag, "tendon_elasticity:0"),
        *(({f"effects.{key}": a}, {f"effects.{key}": b}, name) for key, a, b, name in [
            ("viscoelastic_memory.branches", memory, swapped, "of 0.05 s, 2 s"),
            ("contact", {"friction": 0.3, "obstacles": [box]}, {"friction": 0.3, "obstacles": [plane]}, "of box"),
        ]),
        (order, other, "explicit:2"),
    ]  # fmt: skip
    doors, away = 0, []
    for theirs, own, name in pairs:
        stranger, arm = (ste.Simulation(build("four_tendon", changes)) for changes in (theirs, own))
        for simulation in (stranger, arm):
            command = [0.004, 0.0, 0.0, 0.0] if simulation is stranger and "tendon_elasticity" in name else [2.0, 0.0, 0.0, 0.0]
            simulation.step(command, 0.1)
        state = stranger.state
        state.save(tmp_path / "state.npz")
        for given in (state, ste.State.load(tmp_path / "state.npz"), pickle.loads(pickle.dumps(state))):
            doors += refuse(arm, ValueError, name, lambda arm=arm, given=given: setattr(arm, "state", given))
            doors += refuse(arm, ValueError, name, lambda arm=arm, given=given: ste.simulate(arm.model, np.zeros(4), 0.1, 0.1, given))
        if "contact" in str(theirs):
            doors += refuse(arm, ValueError, name, lambda arm=arm, state=state: contact_forces(arm.model, state))
        if state.effects.size:
            nameless = {key: value for key, value in dataclasses.asdict(state).items() if key != "names"}
            np.savez(tmp_path / "old.npz", **nameless)
            old = ste.State.load(tmp_path / "old.npz")
            doors += refuse(arm, ValueError, "does not name", lambda arm=arm, old=old: setattr(arm, "state", old))
            doors += refuse(stranger, ValueError, "does not name", lambda stranger=stranger, old=old: setattr(stranger, "state", old))
            tips = []
            for states in (arm.state.effects, state.effects):
                arm.reset(effects=states)
                arm.step(np.zeros(4), 0.1)
                tips.append(arm.tip_pose[:3, 3])
            away.append(1e3 * float(np.linalg.norm(tips[1] - tips[0])))
    plain = ste.Simulation(build("four_tendon"))
    plain.state = dataclasses.replace(plain.state, names=())  # nothing inside that could be misread
    measured("doors", doors)
    measured("tip, were it taken [mm]", max(away))


def test_one_word_of_fidelity_at_two_doors(measured):
    """A model built in Python and one that an environment simulates: defaults of their own put them a tenth of the arm apart in motion.
    Expected: the same scene for every word, and "standard" within a hundredth of the distance that "scene" has from "fine".
    """
    scene = ste.load_scene("helical").replace({"segments.0.young_modulus": 9e5})
    words, tips = ("scene", "fast", "standard", "fine", None), {}
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", FieldsWarning)  # of another material
        for word in words:
            model = ste.build_model(scene, fidelity=word)
            with gym.make("TendonRod-Reach-v0", scene=scene, fidelity=word) as env:
                assert env.unwrapped.model.scene == model.scene
            pull = ste.simulate(model, [4.0, 0.0, 3.0, 0.0, 0.0][: model.tendon_count], 0.3, 0.02)
            tips[word] = pull.tip_pose[:, :3, 3]
    away = {word: 1e3 * np.linalg.norm(tips[word] - tips["fine"], axis=1).max() for word in words}
    assert ste.build_model(scene).scene == scene and away["standard"] == away[None] < 0.01 * away["scene"]
    for word, kind in (("exact", ValueError), ("1 furlong", ValueError), ("-1mm", ValueError), (1e-3, TypeError)):
        with pytest.raises(kind, match="fidelity"):
            ste.build_model(scene, fidelity=word)
    measured("scene to fine [mm]", away["scene"])
    measured("standard to fine [mm]", away["standard"])


def test_commands_of_simulate(moving):
    """The three forms of command: tables of the wrong length, functions that turn bad in mid-run or raise.
    Expected: an error that names the argument, or the function's own error, before anything is computed; nothing has changed.
    """
    model, start = moving.model, moving.state
    cases = [
        (ValueError, "command should have shape (10, 10)", np.zeros((9, 10))),
        (ValueError, "command should have shape (10, 10)", np.zeros((10, 9))),
        (ValueError, "command should have shape (10, 10), but its rows are not alike", [[0.0] * 10, [0.0]]),
        (ValueError, "command[4, 2]", np.where(np.arange(100).reshape(10, 10) == 42, NAN, 0.0)),
        (ValueError, "command(0.56)", lambda t: np.zeros(10) if t < 0.55 else np.zeros(3)),
        (ValueError, "command(0.56)[0]", lambda t: np.full(10, 1.0 if t < 0.55 else NAN)),
        (TypeError, "command(0.06)", lambda t: None),
        (KeyError, "own", lambda t: {}["own"]),
        (TypeError, "command", {"0": 1.0}),
        (TypeError, "command", None),
    ]
    for kind, name, tension in cases:
        refuse(moving, kind, name, lambda tension=tension: ste.simulate(model, tension, 1.0, 0.1, start))
    refuse(moving, ValueError, "duration", lambda: ste.simulate(model, np.zeros(10), 0.35, 0.1, start))


def test_arc_lengths(moving):
    """Arc lengths off the rod, NaN, wrong shapes.
    Expected: ValueError or TypeError that names arc_length.
    """
    model, q = moving.model, np.zeros(10)
    bad = [(ValueError, value) for value in ([1.01], [-1e-3], [NAN], 0.5, [[0.5]])] + [(TypeError, ["a"])]
    for kind, value in bad:
        refuse(moving, kind, "arc_length", lambda value=value: model.backbone_at(q, value))
    assert model.backbone_at(q, []).shape == (0, 4, 4)


def test_scenes():
    """Overrides and files that are none, keys that do not exist, NaN and infinity in every number of a scene.
    Expected: ConfigurationError (a ValueError) that names the key, TypeError for what is not even a path or a scene.
    """
    scene = ste.load_scene("paper")
    numbers = ["segments.0.length", "segments.0.young_modulus", "segments.0.poisson_ratio", "segments.0.density", "segments.0.damping",
               "segments.0.radius.base", "tendons.3.routing.radius", "tendons.3.end", "integrator.step", "integrator.tolerance",
               "strain.rank_tolerance"]  # fmt: skip
    for key in numbers:
        for value in (NAN, INF, "1", True, [1.0]):
            with pytest.raises(ste.ConfigurationError, match=key.split(".")[-1]):
                scene.replace({key: value})
    for changes, key in (({"segments.7.length": 1.0}, "segments.7"), ({"nosuch": 1}, "nosuch"), ({"": 1}, "unknown key"),
                         ({"quadrature.intervals": 0}, "intervals"), ({"quadrature.intervals": 2.5}, "intervals")):  # fmt: skip
        with pytest.raises(ste.ConfigurationError, match=key):
            scene.replace(changes)
    for value in ("nosuch", "nosuch.toml", ""):
        with pytest.raises(ste.ConfigurationError):
            ste.load_scene(value)
    for value in (3, None, scene, b"paper", {"name": "paper"}):
        with pytest.raises(TypeError, match="name_or_path should be the name of a shipped scene or the path of a TOML file, not"):
            ste.load_scene(value)
    with pytest.raises(TypeError, match="changes has the key 3: keys should be strings"):
        scene.replace({3: 1})
    with pytest.raises(ste.ConfigurationError, match="has the key 3: keys should be strings"):
        scene.replace({"integrator": {3: 1}})
    for value in ("paper", None, {"name": "paper"}):
        with pytest.raises(TypeError, match="scene should be a Scene"):
            ste.build_model(value)
    assert ste.load_scene("paper") == scene


WRONG_OBJECTS = {
    "Simulation(scene)": lambda model: ste.Simulation(model.scene),
    "simulate(scene)": lambda model: ste.simulate(model.scene, np.zeros(10), 1.0, 0.1),
    "static_equilibrium(scene)": lambda model: static_equilibrium(model.scene, np.zeros(10)),
    "Simulation(state=3)": lambda model: ste.Simulation(model, 3),
    "simulate(initial=3)": lambda model: ste.simulate(model, np.zeros(10), 1.0, 0.1, initial=3),
    "replace(3)": lambda model: model.scene.replace(3), "save_scene(3)": lambda model: ste.save_scene(3, "never.toml"),
}  # fmt: skip


@pytest.mark.cases("door", WRONG_OBJECTS)
def test_wrong_objects(build, door):
    """A scene's name or a scene where a model belongs is the commonest slip of all.
    Expected: TypeError that says what belongs there.
    """
    with pytest.raises(TypeError):
        WRONG_OBJECTS[door](build("paper"))


@pytest.mark.parametrize("value", [1e12, 1e300, -1e300])
def test_absurd_but_finite_tensions(build, value):
    """Finite, but its square overflows.
    Expected: a clear error or `converged` false, with finite numbers in what comes back, and no warning of overflow.
    """
    model, u = build("paper"), vector(value, 0)
    rest = static_equilibrium(model, u)
    assert not rest.converged and rest.reason and np.isfinite(rest.q).all() and np.isfinite(rest.tip_pose).all()
    with pytest.raises(ste.StrainLimitError):
        model.tip_pose(u)
    simulation = ste.Simulation(model)
    with pytest.raises(ste.SimulationDiverged) as caught:
        simulation.step(u, 0.01)
    assert np.isfinite(caught.value.state.q).all()


def test_ragged_lists(build):
    """Nested lists of different lengths make no array.
    Expected: ValueError that names the argument.
    """
    with pytest.raises(ValueError, match="^q should"):
        build("paper").tip_pose([[0.0], [1.0, 2.0]])


def test_file_without_a_state(tmp_path):
    """An archive of arrays, but not of a state.
    Expected: ValueError that names what is missing.
    """
    path = tmp_path / "state.npz"
    np.savez(path, q=np.zeros(10))
    with pytest.raises(ValueError, match="time"):
        ste.State.load(path)


def test_broken_files(tmp_path):
    """Files that are no archive, or do not exist.
    Expected: ValueError, OSError.
    """
    path = tmp_path / "state.npz"
    path.write_text("no archive")
    with pytest.raises(ValueError):
        ste.State.load(path)
    with pytest.raises(OSError):
        ste.State.load(tmp_path / "nowhere.npz")
    with pytest.raises(OSError):
        ste.State.load(tmp_path)
    for value in (3, None, b"state.npz", 1.5):
        with pytest.raises(TypeError, match="path should be a str or a path, not"):
            ste.State.load(value)


def test_altered_files(moving, measured, tmp_path):
    """A state's file cut at every length, with bytes altered, with arrays of other types, or that claims more numbers than memory holds.
    Expected: the state that was saved, or ValueError that names the file.
    """
    path = tmp_path / "state.npz"
    moving.state.save(path)
    whole, rng, refused = path.read_bytes(), np.random.default_rng(0), 0
    files = [whole[: int(n)] for n in np.linspace(0, len(whole) - 1, 300)]
    for _ in range(1200):
        altered = bytearray(whole)
        for at in rng.integers(0, len(whole), rng.integers(1, 4)):
            altered[at] = rng.integers(0, 256)
        files.append(bytes(altered))
    for content in files:
        path.write_bytes(content)
        try:
            state = ste.State.load(path)
        except ValueError as error:
            assert str(path) in str(error)
            refused += 1
        else:
            assert state.q.tobytes() == moving.state.q.tobytes() and state.strain.tobytes() == moving.state.strain.tobytes()
    for name, value in (("q", np.array([None, "q"])), ("time", np.zeros(3)), ("step", np.array("soon"))):
        np.savez(path, **{**dataclasses.asdict(moving.state), name: value})
        with pytest.raises(ValueError, match="holds no state"):
            ste.State.load(path)
    header = io.BytesIO()
    np.lib.format.write_array_header_1_0(header, {"descr": "<f8", "fortran_order": False, "shape": (10**14,)})
    np.savez(path, **{key: value for key, value in dataclasses.asdict(moving.state).items() if key != "q"})
    with zipfile.ZipFile(path, "a") as archive:
        archive.writestr("q.npy", header.getvalue())
    with pytest.raises(ValueError, match="holds no state"):
        ste.State.load(path)
    measured("refused", refused)


def test_state_files_cut_or_changed_anywhere(moving, tmp_path, measured):
    """A full disk cuts a file, a bad one changes a bit: at every length, and in every byte.
    Expected: ValueError or OSError, or the state that was saved; never another one, never another error.
    """
    moving.state.save(tmp_path / "state.npz")
    whole, path, saved = (tmp_path / "state.npz").read_bytes(), tmp_path / "damaged.npz", ste.State.load(tmp_path / "state.npz")
    np.save(tmp_path / "array.npy", saved.q)
    flipped = (whole[:i] + bytes([whole[i] ^ 1 << i % 8]) + whole[i + 1 :] for i in range(len(whole)))
    refused = 0
    for content in (b"", (tmp_path / "array.npy").read_bytes(), *(whole[:size] for size in range(len(whole))), *flipped):
        path.write_bytes(content)
        try:
            found = ste.State.load(path)
        except (ValueError, OSError):
            refused += 1
        else:
            assert all(np.array_equal(getattr(found, name), getattr(saved, name)) for name in vars(saved))
    measured("refused, of files", refused)
    assert refused > len(whole)


def test_state_with_other_coordinates(moving):
    """Coordinates changed by hand, the strain left as it was: the tip would be shown where it is not.
    Expected: ValueError that points to reset, and nothing has changed.
    """
    state = moving.state
    stranger = dataclasses.replace(state, q=state.q + 1.0)
    refuse(moving, ValueError, "state.strain", lambda: setattr(moving, "state", stranger))
    moving.state = state
