"""What an episode draws: a row's material is that of a scene with the same changes; actuators and
sensors err as they say."""

import re

import numpy as np
import pytest

from soft_tendon_env.envs import ShapeEnv, TipPoseEnv, TipPoseVectorEnv
from soft_tendon_env.envs.options import given_scene
from soft_tendon_env.envs.randomization import Randomization
from soft_tendon_env.tools.configuration import ConfigurationError

SMALL = {"scene": "three_tendon", "fidelity": "fast", "action": "tension"}
STEPS = 25


def commands(env, seed=0):
    """Random actions (STEPS, n_a) and their tensions [N]."""
    actions = np.random.default_rng(seed).uniform(
        -1.0, 1.0, (STEPS, env.episodes.model.tendon_count)
    )
    least, greatest = env.episodes.limits.T
    return actions, least + 0.5 * (greatest - least) * (actions + 1.0)


EXPLICIT = {
    "type": "explicit",
    "modes": [{"strains": ["torsion", "bend_y", "bend_z"], "order": 1, "span": "rod"}],
}
LOADED = {"strain": EXPLICIT, "effects.gravity.acceleration": [0.0, 0.0, -3.0]}


@pytest.mark.parametrize(
    ("changes", "factor"), [({}, 1.3), (LOADED, 1.0)], ids=["statics-based", "explicit"]
)
def test_every_error_of_a_shape_vanishes_at_the_shape(changes, factor):
    """Coordinates of a statics-based strain make the same shape of a stiffer rod where they are as
    much greater."""
    target = {"type": "hold", "tension": [2.0, 1.0, 0.5]}
    env = ShapeEnv(
        scene={"scene": "three_tendon", **changes}, target=target, randomize={"stiffness": 1.3}
    )
    env.reset(seed=0)
    episodes = env.episodes
    one = np.arange(1)
    wanted = episodes.target.q[:, 0].copy()
    for q, vanishes in ((wanted, factor == 1.0), (factor * wanted, True)):
        episodes.arms.place(one, q)
        episodes._observe(one)
        assert (episodes.errors["coordinate_error"][0] < 1e-9 * np.abs(wanted).max()) == vanishes
        assert (episodes.errors["backbone_error"][0] < 1e-9) == vanishes


def acting_tensions(env, actions, seed=0):
    """The tensions (20 steps, n_a) that acted in every millisecond of control periods of 20 ms, and
    the observations."""
    episodes = env.episodes
    tensions = []
    apply = episodes.actuation.apply

    def noted(action, members):
        commands, durations = apply(action, members)
        ends = np.cumsum(
            np.full(commands.shape[1], 0.02 / commands.shape[1])
            if durations is None
            else durations[0]
        )
        assert abs(ends[-1] - 0.02) < 1e-15
        tension = commands[0, np.searchsorted(ends, 0.001 * (np.arange(20) + 0.5))]
        tensions.append(tension)
        return commands, durations

    episodes.actuation.apply = noted
    env.reset(seed=seed)
    seen = [env.step(action)[0] for action in actions]
    episodes.actuation.apply = apply
    return np.concatenate(tensions), np.array(seen)


@pytest.mark.parametrize("milliseconds", [13, 20, 100])
def test_latency_delays_the_tensions_by_any_time(milliseconds):
    """What came before is the start's tension, zero."""
    options = {
        **SMALL,
        "scene": {"scene": "three_tendon", "integrator.step": 0.01},
        "fidelity": "scene",
    }
    prompt = TipPoseEnv(**options)
    late = TipPoseEnv(**options, randomize={"latency": 0.001 * milliseconds})
    actions, tensions = commands(prompt)
    fine = np.repeat(tensions, 20, axis=0)
    np.testing.assert_array_equal(acting_tensions(prompt, actions)[0], fine)
    expected = np.concatenate([np.zeros((milliseconds, 3)), fine])[: len(fine)]
    np.testing.assert_array_equal(acting_tensions(late, actions)[0], expected)
    np.testing.assert_array_equal(
        acting_tensions(late, actions)[0], expected
    )  # nothing is left of the last episode


def test_gains_and_offsets_act_on_tensions():
    plain = TipPoseEnv(**SMALL)
    wrong = TipPoseEnv(**SMALL, randomize={"tension_gain": 1.2, "tension_offset": -0.5})
    actions, tensions = commands(plain)
    np.testing.assert_allclose(
        acting_tensions(wrong, actions)[0][::20], np.maximum(1.2 * tensions - 0.5, 0.0), rtol=1e-15
    )
    drawn = TipPoseEnv(**SMALL, randomize={"tension_gain": [0.8, 1.2]})
    ratio = acting_tensions(drawn, actions)[0][::20] / tensions
    expected_ratio = np.tile(ratio[0], (STEPS, 1))
    np.testing.assert_allclose(ratio, expected_ratio)
    assert np.ptp(ratio[0]) > 0.01
    assert (ratio >= 0.8).all()
    assert (ratio <= 1.2).all()


def test_noise_is_on_what_is_measured_and_on_nothing_else():
    of_strain = {"curvature": 0.3, "stretch": 0.02, "curvature_rate": 4.0, "stretch_rate": 0.5}
    noise = {"position": 0.01, "rotation": 0.05, "length": 0.002, **of_strain}
    groups = [
        "coordinates",
        "tip_position",
        "tip_rotation",
        "tendon_lengths",
        "strain",
        "strain_rate",
        "target_error",
    ]
    options = {**SMALL, "observation": groups, "sensors": [0.1, 0.2]}
    plain = TipPoseEnv(**options)
    noisy = TipPoseEnv(**options, randomize={"noise": noise})
    seen = {}
    infos = {}
    for env in (plain, noisy):
        rows = [env.reset(seed=0)[0]]
        told = []
        for _ in range(400):
            observation, reward, _, _, info = env.step(np.zeros(3))
            rows.append(observation)
            told.append((reward, info))
        seen[env] = np.array(rows, dtype=float)
        infos[env] = told
    difference = seen[noisy] - seen[plain]
    slices = plain.episodes.layout.slices
    assert infos[plain] == infos[noisy]  # the target is drawn before the sensors' seed
    assert not difference[:, slices["coordinates"]].any()
    length = plain.episodes.model.length
    for name, deviation in [
        ("tip_position", noise["position"] / length),
        ("tendon_lengths", noise["length"] / (0.1 * length)),
    ]:
        assert difference[:, slices[name]].std() == pytest.approx(deviation, rel=0.1)
    strain = difference[:, slices["strain"]].reshape(-1, 2, 2, 3)
    expected_strain = noise["curvature"] * length
    assert strain[:, :, 0].std() == pytest.approx(expected_strain, rel=0.1)
    assert strain[:, :, 1].std() == pytest.approx(noise["stretch"] / 0.1, rel=0.1)
    rate = difference[:, slices["strain_rate"]].reshape(-1, 2, 2, 3)
    expected_rate = noise["curvature_rate"] * length / 10
    assert rate[:, :, 0].std() == pytest.approx(expected_rate, rel=0.1)
    assert rate[:, :, 1].std() == pytest.approx(noise["stretch_rate"], rel=0.1)
    assert abs(np.corrcoef(strain.ravel(), rate.ravel())[0, 1]) < 0.1  # drawn independently
    columns = seen[noisy][:, slices["tip_rotation"]].reshape(-1, 2, 3)
    np.testing.assert_allclose(np.linalg.norm(columns, axis=2), 1.0, atol=1e-6)
    assert np.abs((columns[1:] * columns[:-1]).sum(axis=2) - 1).max() > 1e-4  # no two samples alike


UNDAMPED = {
    "no damping": {"damping": 0.0},
    "as little as none": {"damping": [0.0, 1.0]},
    "stiff": {"stiffness": [1.0, 1e4]},
    "stiff and lightly damped": {"damping": [0.05, 1.0], "stiffness": [0.5, 10.0]},
}


@pytest.mark.parametrize("drawn", UNDAMPED)
def test_columns_are_those_of_the_least_damping_ratio_that_can_be_drawn(drawn):
    """Three columns amplify what nothing damps; damping ratios fall with the viscosity and grow
    stiffer arms' frequencies."""
    options = {**SMALL, "fidelity": None}
    assert TipPoseEnv(**options).model.scene.integrator.columns is None
    env = TipPoseEnv(**options, randomize=UNDAMPED[drawn])
    assert env.model.scene.integrator.columns == 2
    assert env.episodes.arms._scheme.method.columns == 2


HALF_OMITTED = {
    "stiffness": [1.2, 1.3],
    "tension_gain": [0.8, 0.9],
    "latency": [0.01, 0.02],
    "noise": {"position": 1e-3},
}


def usual_rows(omit):
    """Rows (4, 64) of which stiffness, gain, latency and noise were left out."""
    env = TipPoseVectorEnv(64, threads=1, **SMALL, randomize={**HALF_OMITTED, "omit": omit})
    env.reset(seed=0)
    episodes = env.episodes
    none = np.zeros((64, 3))
    modulus = np.array(
        [episodes.arms.model_of(row).scene.segments[0].young_modulus for row in range(64)]
    )
    stiffness = modulus / episodes.model.scene.segments[0].young_modulus
    late = np.array([episodes.actuation.delay(row) for row in range(64)])
    noisy = np.zeros((2, 64), dtype=bool)
    for k in range(2):
        noisy[k] = (episodes.observed.tip_pose != episodes.arms.reading.tip_pose).any(axis=(1, 2))
        env.step(none)
    gain = episodes.actuation.gain
    assert ((gain == 1.0).all(axis=1) | (gain < 0.9).all(axis=1)).all()
    assert (noisy[0] == noisy[1]).all()
    usual = np.array([stiffness == 1.0, gain[:, 0] == 1.0, late == 0.0, ~noisy[0]])
    assert (usual | np.array([stiffness >= 1.2, gain[:, 0] >= 0.8, late >= 0.01, noisy[0]])).all()
    return usual


def test_what_is_omitted_is_as_the_scene_says():
    """Of numbers, gains, latency and noise about half each, independently; without noise for the
    whole episode."""
    usual = usual_rows(0.5)
    assert (np.abs(usual.mean(axis=1) - 0.5) < 0.2).all()
    assert (np.abs(np.corrcoef(usual)[~np.eye(4, dtype=bool)]) < 0.4).all()


@pytest.mark.parametrize("place", range(4))
def test_each_draw_has_its_own_omission(place):
    """One by name is always left out, half of the others; what no name says is never left out."""
    name = [*HALF_OMITTED][place]
    usual = usual_rows({name: 1.0, "others": 0.5})
    expected = np.full(4, 0.5)
    expected[place] = 1.0
    np.testing.assert_allclose(usual.mean(axis=1), expected, atol=0.2)
    assert usual[place].all()
    assert not np.delete(usual_rows({name: 1.0}), place, axis=0).any()


def test_an_omission_is_of_a_whole_vector_and_of_what_changes_with_it():
    drawn = {
        "effects.gravity.acceleration": [[-1.0, 1.0]] * 3,
        "stiffness": [0.9, 1.1],
        "damping": [0.9, 1.1],
    }
    omit = {
        "effects": {"gravity": 0.9, "gravity.acceleration": 0.3},
        "stiffness": 0.2,
        "others": 0.1,
    }
    ranges = Randomization(**drawn, omit=omit)
    scene = given_scene({"scene": "three_tendon", "effects.gravity.acceleration": [0.0, 0.0, 0.0]})
    omissions = {part.name: ranges.omission(part.name) for part in ranges.ranges(scene)}
    assert omissions == {
        **{f"effects.gravity.acceleration.{k}": 0.3 for k in range(3)},
        "segments.*.young_modulus": 0.2,
        "segments.*.damping": 0.1,
    }


@pytest.mark.parametrize(
    ("omit", "message"),
    [
        ({"latencies": 0.5}, "omit.latencies is nothing that is drawn: did you mean 'latency'?"),
        ({"latency": 1.5}, "omit"),
        ({"payload": 0.5}, "omit.payload is nothing that is drawn"),
        (
            {"stiffness": 0.5, "segments.*.young_modulus": 0.3},
            "omit.segments.*.young_modulus is segments.*.young_modulus, which the table has",
        ),
        ("often", "omit"),
    ],
)
def test_an_omission_of_nothing_is_refused(omit, message):
    with pytest.raises(ConfigurationError, match=re.escape(message)):
        Randomization(stiffness=[0.9, 1.1], latency=[0.0, 0.02], omit=omit)
