"""Cross-sections and spacer discs against closed forms: cantilevers, torsion, natural frequencies,
Timoshenko's beam."""

import warnings

import numpy as np
import pytest
from scipy.linalg import eigh

from soft_tendon_env import (
    ConfigurationError,
    build_model,
    load_scene,
    scene_parameters,
    static_equilibrium,
)
from soft_tendon_env.envs.randomization import Randomization
from soft_tendon_env.model.grid import screw_matrices
from soft_tendon_env.scene.scene import Scene, rod_radius, scene_to_dict

L = 0.3  # length [m]
E = 2e9  # Young's modulus [Pa]
NU = 0.3  # Poisson's ratio
RHO = 1200.0  # density [kg/m^3]
ETA = 4e6  # viscosity [Pa s]
G = E / (2 * (1 + NU))  # shear modulus [Pa]
SHEAR = ("torsion", "bend_y", "bend_z", "stretch", "shear_y", "shear_z")
KIRCHHOFF = SHEAR[:3]
TUBE = {"type": "tube", "radius": 0.006, "inner_radius": 0.005}
DISCS = {"mass": 2e-3, "radius": 0.015, "thickness": 0.003}
STIFF = {
    "type": "stiffness",
    "bending": [0.3, 0.7],
    "torsion": 0.4,
    "stretch": 4e4,
    "shear": 2e4,
    "mass_per_length": 0.05,
}
TABLE = {"type": "table", "arc_length": [0.0, 0.1, 0.3]}
STIFF |= {"retardation_time": 0.01, "radius": 0.006}


def tube(R, r):
    area = np.pi * (R**2 - r**2)
    bending = np.pi * (R**4 - r**4) / 4
    torsion = 2 * bending
    return area, bending, bending, torsion


def ellipse(a, b):
    return (
        np.pi * a * b,
        np.pi * a * b**3 / 4,
        np.pi * b * a**3 / 4,
        np.pi * a**3 * b**3 / (a**2 + b**2),
    )


def rectangle(w, h, beta):
    """beta: Timoshenko and Goodier, Theory of Elasticity, section 109, table of torsion constants
    beta * long * short^3."""
    bending_y = w * h**3 / 12
    bending_z = h * w**3 / 12
    short, long = sorted([w, h])
    torsion = beta * long * short**3
    return w * h, bending_y, bending_z, torsion


SECTIONS = [  # with A, Iy, Iz and J
    (TUBE, tube(0.006, 0.005)),
    ({"type": "ellipse", "width": 0.012, "height": 0.006}, ellipse(0.006, 0.003)),
    ({"type": "rectangle", "width": 0.008, "height": 0.008}, rectangle(0.008, 0.008, 0.1406)),
    ({"type": "rectangle", "width": 0.004, "height": 0.012}, rectangle(0.004, 0.012, 0.2633)),
    ({"type": "rectangle", "width": 0.02, "height": 0.002}, rectangle(0.02, 0.002, 0.3123)),
]
TAPERED = [
    {
        **TUBE,
        "radius": {**TABLE, "radius": [0.006, 0.005, 0.004]},
        "inner_radius": {"type": "linear", "base": 0.004, "tip": 0.003},
    },
    {"type": "rectangle", "width": {**TABLE, "size": [0.006, 0.005, 0.004]}, "height": 0.004},
    {"type": "ellipse", "width": {**TABLE, "size": [0.006, 0.005, 0.004]}, "height": 0.003},
]


def arm(section, strains=KIRCHHOFF, order=4, length=L, **changes):
    segment = {
        "length": length,
        "young_modulus": E,
        "poisson_ratio": NU,
        "density": RHO,
        "damping": ETA,
        "section": section,
    }
    if section.get("type") == "stiffness":
        segment = {"length": length, "section": section}
    if "type" not in section:
        segment |= {"section": None, **section}
    tendon = {"routing": {"type": "straight", "offset": [0.001, 0.0]}}
    strain = {
        "type": "explicit",
        "modes": [{"strains": list(strains), "order": order, "span": "rod"}],
    }
    scene = Scene.parse(
        {"name": "arm", "segments": [segment], "tendons": [tendon], "strain": strain}, "arm"
    ).replace(changes)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        return build_model(scene, "scene")


def tip_under(section, force=(0.0, 0.0, 0.0), moment=(0.0, 0.0, 0.0), **options):
    return static_equilibrium(
        arm(section, **options, **{"effects.tip_load": {"force": force, "moment": moment}}), [0.0]
    ).tip_pose


def frequencies(model):
    """Natural frequencies [rad/s]."""
    rest = np.zeros(model.coordinate_count)
    terms = model.terms(rest, rest)
    return np.sqrt(eigh(terms.stiffness, terms.mass, eigvals_only=True))


@pytest.mark.parametrize(("section", "known"), SECTIONS)
def test_cantilevers_about_both_axes_and_torsion(section, known):
    """A small force F at the tip bends by F L^3 / (3 E I), and a moment T twists by T L / (G J); J
    is tabled to 4 digits."""
    _, bending_y, bending_z, torsion = known
    for axis, bending in ((1, bending_z), (2, bending_y)):
        force = 1e-4 * E * bending / L**2
        direction = np.eye(3)[axis]
        tip = tip_under(section, force=force * direction)
        deflection = force * L**3 / (3 * E * bending)
        np.testing.assert_allclose(tip[axis, 3], deflection, rtol=1e-6)
    twist = 0.5
    moment = twist * G * torsion / L
    pose = tip_under(section, moment=(moment, 0.0, 0.0))
    angle = np.arctan2(pose[2, 1], pose[1, 1])
    np.testing.assert_allclose(angle, twist, rtol=3e-4)


@pytest.mark.parametrize(("section", "known"), SECTIONS)
def test_first_three_frequencies_about_both_axes_and_of_torsion(section, known):
    """Euler-Bernoulli, less Rayleigh's share of rotary inertia to first order, and sqrt(G J / (rho
    Ip)) of a twisted bar."""
    area, *bending, torsion = known
    roots = np.array([1.87510407, 4.69409113, 7.85475744])
    slopes = np.array(
        [4.6478, 32.417, 77.299]
    )  # integrals of phi'^2 over 1, with phi^2 integrating to 1
    for strain, second in zip(("bend_y", "bend_z"), bending, strict=True):
        exact = (
            (roots / L) ** 2
            * np.sqrt(E * second / (RHO * area))
            / np.sqrt(1 + slopes * second / (area * L**2))
        )
        found = frequencies(arm(section, (strain,), 8, **{"quadrature.intervals": 24}))[:3]
        np.testing.assert_allclose(found, exact, rtol=1e-3)
    wave_numbers = np.pi / L * np.array([0.5, 1.5, 2.5])
    polar = sum(bending)
    exact = wave_numbers * np.sqrt(G * torsion / (RHO * polar))
    np.testing.assert_allclose(
        frequencies(arm(section, ("torsion",), 8, **{"quadrature.intervals": 24}))[:3],
        exact,
        rtol=3e-4,
    )


@pytest.mark.parametrize("correction", [1.0, 0.53])
def test_a_short_tube_bends_and_shears_as_timoshenko_says(correction):
    """At L / d = 6: F L^3 / (3 E I) + F L / (k G A)."""
    area, bending, *_ = tube(0.006, 0.005)
    length = 12 * 0.006
    force = 0.01
    pose = tip_under(
        {**TUBE, "shear_correction": correction},
        force=(0.0, force, 0.0),
        length=length,
        strains=SHEAR,
    )
    by_bending = force * length**3 / (3 * E * bending)
    by_shear = force * length / (correction * G * area)
    np.testing.assert_allclose(pose[1, 3], by_bending + by_shear, rtol=1e-5)


def test_what_is_a_circle_too_equals_the_circle():
    circle = arm({"radius": 0.006}, SHEAR)
    area, bending, _, torsion = tube(0.006, 0.0)
    numbers = {
        "bending": 2 * [E * bending],
        "torsion": G * torsion,
        "stretch": E * area,
        "shear": G * area,
    }
    stiff = {**STIFF, **numbers, "mass_per_length": RHO * area, "retardation_time": 3 * ETA / E}
    round_ellipse = {"type": "ellipse", "width": 0.012, "height": 0.012}
    alike = [
        arm(section, SHEAR) for section in ({**TUBE, "inner_radius": 1e-9}, round_ellipse, stiff)
    ]
    places = np.linspace(0.0, L, 7)
    for model in alike:
        for parts in zip(
            *(screw_matrices(one.scene, places) for one in (circle, model)), strict=True
        ):
            same = (
                slice(None) if model is not alike[-1] else np.s_[:, 1:4]
            )  # one time constant is the viscosity's where nu = 0.5
            np.testing.assert_allclose(parts[1][same], parts[0][same], rtol=1e-12)
    np.testing.assert_allclose(
        screw_matrices(alike[-1].scene, places)[::2],
        screw_matrices(circle.scene, places)[::2],
        rtol=1e-12,
    )


@pytest.mark.parametrize("section", TAPERED)
def test_sizes_follow_tapers(section):
    """The outer radius' slope is its derivative, and a scene survives as a table, with the old key
    of tabled radii too."""
    scene = arm(section).scene
    x = np.linspace(0.011, 0.289, 15)
    h = 1e-6
    np.testing.assert_allclose(
        rod_radius(scene, x)[1],
        (rod_radius(scene, x + h)[0] - rod_radius(scene, x - h)[0]) / (2 * h),
        atol=1e-7,
    )
    assert Scene(**scene_to_dict(scene)) == scene


def beam_with_masses(places, mass, rotary, bending, line_mass, line_rotary):
    """Natural frequencies [rad/s] of a clamped Rayleigh beam with masses at places, by 300 cubic
    elements."""
    count = 300
    h = L / 300
    scale = np.diag([1.0, h, 1.0, h])
    stiff = (
        np.array([[12, 6, -12, 6], [6, 4, -6, 2], [-12, -6, 12, -6], [6, 2, -6, 4]])
        * bending
        / h**3
    )
    heavy = (
        np.array([[156, 22, 54, -13], [22, 4, 13, -3], [54, 13, 156, -22], [-13, -3, -22, 4]])
        * line_mass
        * h
        / 420
    )
    heavy += (
        np.array([[36, 3, -36, 3], [3, 4, -3, -1], [-36, -3, 36, -3], [3, -1, -3, 4]])
        * line_rotary
        / (30 * h)
    )
    K, M = np.zeros((2, 2 * count + 2, 2 * count + 2))
    for i in range(count):
        part = np.s_[2 * i : 2 * i + 4, 2 * i : 2 * i + 4]
        K[part] += scale @ stiff @ scale
        M[part] += scale @ heavy @ scale
    for at in 2 * np.rint(np.array(places) / h).astype(int):
        M[at, at] += mass
        M[at + 1, at + 1] += rotary
    return np.sqrt(eigh(K[2:, 2:], M[2:, 2:], eigvals_only=True))


@pytest.mark.parametrize(
    "where", [{"number": 1}, {"number": 6}, {"number": 20}, {"places": [0.09, 0.21]}]
)
def test_discs_are_lumped_masses_with_rotary_inertia(where):
    area, bending, *_ = tube(0.006, 0.005)
    changes = {"segments.0.discs": {**DISCS, **where}, "quadrature.intervals": 30}
    model = arm(TUBE, ("bend_y",), 9, **changes)
    places = where.get("places")
    if places is None:
        number = where["number"]
        places = L * np.arange(1, number + 1) / number
    mass = DISCS["mass"]
    # of a cylinder, about a diameter
    round_share = DISCS["radius"] ** 2 / 4
    flat_share = DISCS["thickness"] ** 2 / 12
    rotary = mass * (round_share + flat_share)
    exact = beam_with_masses(places, mass, rotary, E * bending, RHO * area, RHO * bending)
    np.testing.assert_allclose(frequencies(model)[:3], exact[:3], rtol=1e-3)


@pytest.mark.parametrize(
    "where", [{"number": 7}, {"number": 20}, {"places": [0.113, 0.222, 0.287]}]
)
def test_weight_of_discs_on_few_intervals(where):
    """Sag under small weight, sum m g x^2 (3 L - x) / (6 E I), on intervals that the places do not
    meet."""
    _, bending, *_ = tube(0.006, 0.005)
    loads = {
        "segments.0.discs": {**DISCS, **where},
        "segments.0.density": 1e-6,
        "effects.gravity.acceleration": [0.0, 0.0, -1e-3],
    }
    places = where.get("places")
    if places is None:
        number = where["number"]
        places = L * np.arange(1, number + 1) / number
    x = np.array(places)
    weight = DISCS["mass"] * 1e-3
    sags = weight * x**2 * (3 * L - x)
    exact = -sags.sum() / (6 * E * bending)
    tip = static_equilibrium(arm(TUBE, ("bend_y", "bend_z"), 3, **loads), [0.0]).tip_pose
    np.testing.assert_allclose(tip[2, 3], exact, rtol=2e-3)


REFUSED = [
    (
        {"segments.0.inner_radius": 0.003},
        'inner_radius is an unknown key .*, and a tube is written section = {type = "tube"',
    ),
    (
        {"segments.0.radius": 0.01},
        (
            r"segments\[0\].radius is 0.01: it should be left out: the section, of type 'tube',"
            r" takes its place"
        ),
    ),
    (
        {"segments.0.section": None},
        r"segments\[0\].radius is missing: it is required, or a section",
    ),
    (
        {"segments.0.section.inner_radius": 0.007},
        r"section.inner_radius is 0.007: it should be less than the radius there, 0.006",
    ),
    (
        {"segments.0.section": STIFF},
        r"segments\[0\].density is 1200.0: it should be left out: the section, of type 'stiffness'",
    ),
    (
        {"segments.0.discs": DISCS},
        "discs.places is None: it should be arc lengths .* or a number of discs",
    ),
    (
        {"segments.0.discs": {**DISCS, "places": [0.1, 0.4]}},
        "discs.places go to 0.4: they should be at most the length, 0.3",
    ),
    (
        {"segments.0.discs": {**DISCS, "number": 3, "radius": 0.005}},
        "discs.radius is 0.005: it should be greater than that of the rod",
    ),
    (
        {
            "segments.0.discs": {"mass": 1e-3, "radius": 0.02, "number": 3},
            "effects.fluid.density": 1e3,
        },
        r"segments\[0\].discs.thickness is missing: in a fluid it is required",
    ),
    (
        {"segments.0.section": SECTIONS[1][0], "effects.nonlinear_elasticity.bending": 5.0},
        (
            r"effects.nonlinear_elasticity.bending has one e0 for both curvatures: .* that of"
            r" segments\[0\] does not"
        ),
    ),
]


@pytest.mark.parametrize(("changes", "message"), REFUSED)
def test_mistakes_are_refused_by_name(changes, message):
    with pytest.raises(ConfigurationError, match=message):
        arm(TUBE, **changes)


def test_numbers_of_sections_are_parameters():
    """A model with another number is as one that is built with it; what is short for the whole rod
    changes stiffnesses too."""
    model = arm(TUBE, **{"segments.0.discs": {**DISCS, "number": 5}, "quadrature.intervals": 6})
    still = np.zeros(15)
    for key in (
        "segments.0.section.inner_radius",
        "segments.0.discs.mass",
        "segments.0.discs.radius",
    ):
        value = 0.99 * scene_parameters(model.scene, [key])[0].value
        built = build_model(model.scene.replace({key: value}), "scene")
        np.testing.assert_array_equal(
            model.with_numbers({key: value}).terms(still, still).mass,
            built.terms(still, still).mass,
        )
    without = {
        f"segments.0.{key}": None
        for key in ("young_modulus", "poisson_ratio", "density", "damping", "radius")
    }
    changes = {**without, "segments.0.section": STIFF}
    mixed = load_scene("two_segment_six").replace(changes)
    drawn = {
        key: value
        for one in Randomization(stiffness=0.5, damping=2.0).ranges(mixed)
        for key, value in one.changes(one.least).items()
    }
    changed = mixed.replace(drawn).segments
    assert changed[0].section.bending == (0.15, 0.35)
    assert changed[0].section.retardation_time == 0.02
    assert changed[1].young_modulus == 0.5 * mixed.segments[1].young_modulus
    assert changed[1].damping == 2.0 * mixed.segments[1].damping
