"""Sensitivities of equilibria against differences of equilibria that are solved again, on every scene and with loads of all kinds."""

import warnings

import numpy as np
import pytest

from soft_tendon_env.accuracy.fidelity import build_model
from soft_tendon_env.model.model import model_on
from soft_tendon_env.model.static_sensitivity import static_sensitivities
from soft_tendon_env.model.statics import static_equilibrium, static_tip_jacobian
from soft_tendon_env.scene.file import load_scene, scene_names
from soft_tendon_env.scene.parameters import scene_parameters
from soft_tendon_env.tools.configuration import ConfigurationError

FOURTH_ORDER = {-2: 1.0 / 12.0, -1: -2.0 / 3.0, 1: 2.0 / 3.0, 2: -1.0 / 12.0}
TOLERANCE = 1e-6
WEIGHT = {"effects.gravity.acceleration": [0.0, 0.0, -3.0], "effects.tip_load.mass": 0.002}
HANGING = {"effects.gravity.acceleration": [9.81, 0.0, 0.0]}
OF_ALL = ["segments.*.young_modulus", "segments.0.density", "effects.gravity.acceleration.2"]
FULL = {
    "type": "explicit",
    "modes": [{"strains": ["torsion", "bend_y", "bend_z", "stretch", "shear_y", "shear_z"], "order": 2, "span": "rod"}],
}
ONE = "three_tendon"
SCENES = [
    *((name, None, {} if name == "underwater" else WEIGHT, OF_ALL[:2] if name == "underwater" else OF_ALL) for name in scene_names()),
    ("paper", "standard", WEIGHT, ["segments.0.radius.base", "tendons.0.routing.fraction", "effects.tip_load.mass"]),
    ("helical", "fine", WEIGHT, ["tendons.0.routing.offset.0", "segments.*.radius", "tendons.*.routing.*.1"]),
    ("underwater", "fast", {}, ["effects.fluid.density", "effects.gravity.acceleration.1", "segments.0.radius.tip"]),
]
"""Scenes, fidelities, changes and parameters."""
INSIDE = {"strain.include_loads": True}
KINDS = [
    ({"effects.fluid": {"density": 1e3, "current": [0.1, 0.3, 0.2]}}, ["effects.fluid.current.1", "effects.fluid.normal_drag"]),
    ({**WEIGHT, **INSIDE}, [*OF_ALL, "effects.tip_load.mass", "effects.gravity.acceleration.1", "segments.*.radius"]),
    ({**INSIDE, "effects.tip_load": {"moment": [0, 1e-3, 0]}}, ["effects.tip_load.moment.0", "effects.tip_load.force.2"]),
    ({**INSIDE, "effects.tip_load": {}}, ["effects.tip_load.force.2"]),
    ({**HANGING, "strain": FULL}, [*OF_ALL, "segments.0.radius", "tendons.0.routing.offset.1"]),
    ({**HANGING, "effects.nonlinear_elasticity": {"bending": 5.0, "stretch": 0.05}}, ["effects.nonlinear_elasticity.bending"]),
    ({"segments.0.curvature": [0.1, 0.0, 1.0]}, ["segments.0.curvature.0", "segments.0.curvature.1"]),
    ({"effects.tip_load": {}}, ["effects.tip_load.force.1", "effects.tip_load.moment.0", "segments.0.curvature.2"]),
]
"""Changes of a scene and parameters."""


def built(name, fidelity, changes):
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # passive fields that were made for other loads
        return build_model(load_scene(name).replace(changes), fidelity)


def at_rest(model, tension, guesses):
    found = [static_equilibrium(model, u, guess) for u, guess in zip(tension, guesses, strict=True)]
    assert all(own.converged for own in found)
    return np.array([own.q for own in found])


def measured(model, q, stations, sensors):
    tips, poses = (np.array([model.backbone_at(own, places) for own in q]) for places in ([model.length], stations))
    return [
        q,
        tips[:, 0],
        poses,
        np.array([model.tendon_lengths(own) for own in q]),
        np.array([model.strain_at(own, sensors)[0] for own in q]),
    ]


def twist(poses, slopes):
    """Body twists (.., 6) of poses (.., 4, 4) with derivatives (.., 4, 4)."""
    moved = np.linalg.inv(poses) @ slopes
    return np.stack([moved[..., 2, 1], moved[..., 0, 2], moved[..., 1, 0], *np.moveaxis(moved[..., :3, 3], -1, 0)], axis=-1)


@pytest.mark.slow
@pytest.mark.cases("name, fidelity, changes, keys", SCENES)
def test_every_scene_is_as_equilibria_that_are_solved_again(name, fidelity, changes, keys):
    check(built(name, fidelity, changes), keys)


@pytest.mark.cases("changes, keys", KINDS)
def test_every_kind_of_load_is_as_equilibria_that_are_solved_again(changes, keys):
    check(built(ONE, "scene" if "strain" in changes else "fast", changes), keys)


def check(model, keys):
    """Sensitivities under random tensions against differences of equilibria."""
    touching = model.scene.effects.contact is not None  # which sets in over a small way
    least, greatest = np.array([tendon.tension_limits for tendon in model.scene.tendons]).T
    tension = least + np.random.default_rng(0).uniform(0.0, 0.35, (2, least.size)) * (greatest - least)
    q = at_rest(model, tension, [None, None])
    places = np.linspace(0.1, 1.0, 4) * model.length, np.array([0.2, 0.8]) * model.length
    found = static_sensitivities(model, q, tension, keys, stations=places[0], sensors=places[1])
    for actual, expected in zip(found.reading, measured(model, q, *places)[1:], strict=True):
        np.testing.assert_allclose(actual, expected, atol=1e-10)
    for i, parameter in enumerate(scene_parameters(model.scene, keys)):
        step = (1e-5 if touching else 5e-3) * (1.0 if parameter.is_factor else parameter.size or 1e-3)
        slopes = [0.0] * 5
        for k, weight in FOURTH_ORDER.items():
            other = model.with_numbers(parameter.changes(parameter.value + k * step))
            solved = measured(other, at_rest(other, tension, q), *places)
            slopes = [slope + weight / step * value for slope, value in zip(slopes, solved, strict=True)]
        slopes[1:3] = twist(found.reading.tip_pose, slopes[1]), twist(found.reading.stations, slopes[2])
        for actual, slope in zip(found.parameters, slopes, strict=True):
            np.testing.assert_allclose(actual[..., i], slope, atol=TOLERANCE * np.abs(slope).max() + 1e-12 / step)


@pytest.mark.cases(
    "fidelity, changes", [("fast", {}), ("fast", WEIGHT), ("fast", {**WEIGHT, "strain.include_loads": True}), ("scene", {"strain": FULL})]
)
def test_derivatives_by_tension(fidelity, changes):
    model, tension, step = built(ONE, fidelity, changes), np.array([1.0, 3.0, 0.5]), 1e-2
    q = at_rest(model, [tension], [None])[0]
    found = static_sensitivities(model, q, tension)
    sides = [at_rest(model, tension + k * step * np.eye(3), [q] * 3) for k in FOURTH_ORDER]
    slopes = np.einsum("k,kji->ij", [*FOURTH_ORDER.values()], sides) / step
    np.testing.assert_allclose(found.tension.q, slopes, atol=TOLERANCE * np.abs(slopes).max())
    tip = found.tension.tip_pose
    np.testing.assert_allclose(static_tip_jacobian(model, q, tension), tip, atol=2e-6 * np.abs(tip).max())
    assert found.parameters.q.shape == (model.coordinate_count, 0)


def test_many_equilibria_are_as_each_alone():
    model, tension = built(ONE, "fast", WEIGHT), np.array([[1.0, 0.0, 2.0], [0.0, 3.0, 1.0], [2.0, 0.5, 0.0]])
    q = at_rest(model, tension, [None] * 3)
    together = static_sensitivities(model, q, tension, OF_ALL, stations=[0.1], sensors=[0.2])
    for i in range(3):
        alone = static_sensitivities(model, q[i], tension[i], OF_ALL, stations=[0.1], sensors=[0.2])
        for part, own in zip(together, alone, strict=True):
            for values, value in zip(part, own, strict=True):
                np.testing.assert_allclose(values[i], value, rtol=1e-12, atol=1e-12 * np.abs(value).max(initial=0.0))


@pytest.mark.cases(
    "key, changes, value",
    [
        ("segments.0.poisson_ratio", {}, 0.5),  # its greatest
        ("effects.tip_load.mass", {**HANGING, "effects.tip_load.mass": 0.0}, 0.0),  # its least
    ],
)
def test_derivatives_at_a_bound_are_those_just_inside(key, changes, value):
    model, tension = built(ONE, "scene", {"strain": FULL, **changes}), np.array([1.0, 3.0, 0.5])
    inside = model.with_numbers({key: value - 1e-6 if value else 1e-6})
    at_bound, beside = (static_sensitivities(own, at_rest(own, [tension], [None])[0], tension, [key]).parameters for own in (model, inside))
    np.testing.assert_allclose(at_bound.tip_pose, beside.tip_pose, atol=1e-4 * np.abs(beside.tip_pose).max())


def test_other_numbers_are_those_of_the_scene():
    model, changes = (
        built("paper", "scene", WEIGHT),
        {"segments.*.young_modulus": 1.1e6, "tendons.0.routing.angle": 3.0, "segments.0.density": 90.0},
    )
    tension = np.linspace(0.0, 5.0, 10)
    other, rebuilt = model.with_numbers(changes), model_on(model.scene.replace(changes), model.grid.per_piece)
    np.testing.assert_allclose(static_equilibrium(other, tension).tip_pose, static_equilibrium(rebuilt, tension).tip_pose, atol=1e-9)


@pytest.mark.cases(
    "changes, key, message",
    [
        ({}, "quadrature.intervals", "quadrature.intervals is no number of the scene"),
        ({"effects.actuators.delay": 0.013}, "effects.actuators.delay", "effects.actuators.delay changes the number of internal states"),
        ({}, "segments.0.poisson_ratio", r"segments\[0\].poisson_ratio is 0.9"),
    ],
)
def test_numbers_that_cannot_be_are_refused(changes, key, message):
    with pytest.raises(ConfigurationError, match=message):
        built(ONE, "fast", changes).with_numbers({key: 0.9})


def test_what_is_no_equilibrium_is_refused():
    model = built(ONE, "fast", {})
    with pytest.raises(ValueError, match=r"q\[1\] is off by \S+ rad under tension\[1\]: see static_equilibrium"):
        static_sensitivities(model, np.zeros((2, model.coordinate_count)), [[0.0, 0.0, 0.0], [1.0, 0.0, 0.0]])
    with pytest.raises(ValueError, match="sensors should lie between 0 and 0.3, not 0.4"):
        static_sensitivities(model, np.zeros(model.coordinate_count), np.zeros(3), sensors=[0.4])
    with pytest.raises(ValueError, match=r"tension should have shape \(2, 3\), not \(3,\)"):
        static_sensitivities(model, np.zeros((2, model.coordinate_count)), np.zeros(3))
