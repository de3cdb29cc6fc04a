"""Numbers that are implausible as shares of the arm get a word; arms as people build them none."""

import copy
import math
import warnings

import numpy as np
import pytest

from soft_tendon_env import Scene, load_scene, scene_names
from soft_tendon_env.envs.option_units import warn_of_memory, warn_of_options
from soft_tendon_env.envs.options import Options
from soft_tendon_env.scene.plausibility import implausible, scales_of
from soft_tendon_env.scene.units import UnitsWarning, warn_of_units

LENGTH = 0.4  # [m]
RADIUS = 0.012  # [m]
OFFSET = 0.009  # [m] of the tendons from the axis
MODULUS = 4e5  # [Pa]
DENSITY = 1100.0  # [kg/m^3]
AREA = math.pi * RADIUS**2
BENDING = MODULUS * AREA * RADIUS**2 / 4.0
STIFFNESS = {
    "type": "stiffness",
    "bending": [BENDING, BENDING],
    "torsion": 0.7 * BENDING,
    "stretch": MODULUS * AREA,
    "shear": MODULUS * AREA / 3.0,
    "mass_per_length": DENSITY * AREA,
    "retardation_time": 0.03,
    "radius": RADIUS,
}
SOLID = {
    "length": LENGTH,
    "radius": RADIUS,
    "young_modulus": MODULUS,
    "poisson_ratio": 0.45,
    "density": DENSITY,
    "damping": 3e3,
}
DISCS = {"number": 6, "mass": 3e-3, "radius": 0.02, "thickness": 3e-3}
HELIX = {"type": "helix", "radius": OFFSET, "angular_rate": 5.0, "phase": 120.0}


def silicone_arm():
    """Tables of an arm of silicone with three tendons, in SI units."""
    tendons = []
    for angle in (0.0, 2.0, 4.0):
        offset = [OFFSET * math.cos(angle), OFFSET * math.sin(angle)]
        routing = {"type": "straight", "offset": offset}
        tendons.append({"routing": routing, "tension_limits": [0.0, 6.0]})
    return {"name": "silicone", "segments": [copy.deepcopy(SOLID)], "tendons": tendons}


def with_stiffness(**numbers):
    """The arm with a section of stiffnesses."""
    section = {**STIFFNESS, **numbers}
    return {"segments": [{"length": LENGTH, "section": section}]}


def words_of(tables):
    """What is said of a scene."""
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        warn_of_units(Scene.parse(tables, "arm"))
    return " ".join(str(warning.message) for warning in caught)


def loads(name, **numbers):
    return {"effects": {name: numbers}}


WRONG = {
    "bending in N mm^2": (with_stiffness(bending=[1e6 * BENDING] * 2), "N mm^2"),
    "one bending in N mm^2": (with_stiffness(bending=[BENDING, 1e6 * BENDING]), "N mm^2"),
    "torsion in N mm^2": (with_stiffness(torsion=7e5 * BENDING), "N mm^2"),
    "stretch in kN": (with_stiffness(stretch=1e-3 * MODULUS * AREA), "strain the rod by"),
    "mass in g/m": (with_stiffness(mass_per_length=1e3 * DENSITY * AREA), "g/m"),
    "retardation in ms": (with_stiffness(retardation_time=30.0), "ms"),
    "rotary inertia in g mm": (with_stiffness(rotary_inertia=[36.0, 18.0, 18.0]), "g mm"),
    "damping in another unit": ({"segments": [{**SOLID, "damping": 1e12}]}, "critical damping"),
    "damping in mPa s": ({"segments": [{**SOLID, "damping": 3e6}]}, "critical damping"),
    "Poisson's ratio in %": ({"segments": [{**SOLID, "poisson_ratio": 0.0045}]}, "Rubbers"),
    "bow in deg/m": ({"segments": [{**SOLID, "curvature": [0, 0, 120.0]}]}, "deg/m"),
    "discs in g": ({"segments": [{**SOLID, "discs": {**DISCS, "mass": 3.0}}]}, "is it g?"),
    "discs in mm": ({"segments": [{**SOLID, "discs": {**DISCS, "radius": 20.0}}]}, "mm"),
    "thickness in mm": ({"segments": [{**SOLID, "discs": {**DISCS, "thickness": 3.0}}]}, "mm"),
    "payload in g": (loads("tip_load", mass=15.0), "is it g"),
    "force in mN": (loads("tip_load", force=[0, 40.0, 0]), "mN"),
    "moment in N mm": (loads("tip_load", moment=[0, 0, 6.0]), "N mm"),
    "inertia in g mm^2": (loads("tip_load", mass=0.01, inertia=[900.0] * 3), "g mm^2"),
    "gravity in mm/s^2": (loads("gravity", acceleration=[0, 0, -9806.65]), "mm/s^2"),
    "gravity in cm/s^2": (loads("gravity", acceleration=[-981.0, 0, 0]), "cm/s^2"),
    "gravity in g": (loads("gravity", acceleration=[0, -1.0, 0]), "9.81"),
    "disturbance in mN": (
        loads("disturbance", loads=[{"at": 0.4, "force": [0, 60.0, 0]}]),
        "mN",
    ),
    "base in rad": ({"base": {"rotation": [0, 0, -1.571]}}, "base.rotation is -1.571: is it rad?"),
    "swing of the base in mm": (loads("moving_base", amplitude=[30, 0, 0], frequency=0.3), "mm"),
    "swing of the base in deg": (
        loads("moving_base", angular_amplitude=25.0, frequency=0.2),
        "is it deg",
    ),
    "turning in deg/s": (loads("moving_base", angular_velocity=120.0), "deg"),
    "elastic tendons in N/mm": (
        loads("tendon_elasticity", stiffness=5.0, displacement_limits=[0.0, 0.02]),
        "N/mm",
    ),
    "displacements in mm": (
        loads("tendon_elasticity", stiffness=5e3, displacement_limits=[-5.0, 20.0]),
        "mm",
    ),
    "lag in ms": (loads("actuators", time_constant=35.0), "ms"),
    "delay in ms": (loads("actuators", delay=15.0), "ms"),
    "rate limit in N/ms": (loads("actuators", rate_limit=0.025), "N/ms"),
    "friction in %": (loads("tendon_friction", coefficient=9.0), "%"),
    "stiction in mm/s": (loads("tendon_friction", coefficient=0.2, stiction_speed=0.2), "mm/s"),
    "water in g/cm^3": (loads("fluid", density=0.998), "g/cm^3"),
    "current in mm/s": (loads("fluid", density=998.0, current=[150.0, 0, 0]), "mm/s"),
    "obstacle in mm": (
        loads(
            "contact", obstacles=[{"type": "sphere", "position": [250.0, 90.0, 0], "radius": 0.05}]
        ),
        "mm",
    ),
    "step in ms": ({"integrator": {"step": 10.0}}, "ms"),
    "tolerance in mm": ({"integrator": {"tolerance": 0.5}}, "mm"),
}


@pytest.mark.parametrize("name", WRONG)
def test_other_units_get_a_word(name):
    changes, words = WRONG[name]
    text = words_of({**silicone_arm(), **changes})
    assert words in text, text


@pytest.mark.parametrize(
    ("routing", "words"),
    [
        ({**HELIX, "angular_rate": 5.0 * 180.0 / math.pi}, "deg/m"),
        ({**HELIX, "angular_rate": 40.0, "phase": 2.094}, "is it rad"),
        ({"type": "surface", "fraction": 0.9, "angle": 4.189}, "is it rad"),
        ({"type": "straight", "offset": [0.0, 0.06]}, "radii of a soft rod"),
    ],
)
def test_tendons_in_other_units_get_a_word(routing, words):
    tables = silicone_arm()
    tables["tendons"][1]["routing"] = routing
    assert words in words_of(tables)


def test_the_arm_itself_and_scenes_that_ship_get_none():
    assert words_of(silicone_arm()) == ""
    assert words_of({**silicone_arm(), **with_stiffness()}) == ""
    assert words_of({**silicone_arm(), "segments": [{**SOLID, "discs": DISCS}]}) == ""
    for name in scene_names():
        scene = load_scene(name)
        assert not [*implausible(scene)]


@pytest.mark.parametrize("size", [0.05, 1.0, 20.0])
def test_a_stiction_speed_is_beside_the_speed_of_the_arm_s_own_tendons(size):
    """Arms of one shape and material, of any size, slide at one speed."""
    tables = silicone_arm()
    (segment,) = tables["segments"]
    segment["length"] *= size
    segment["radius"] *= size
    segment["damping"] *= size
    for tendon in tables["tendons"]:
        tendon["routing"]["offset"] = [size * offset for offset in tendon["routing"]["offset"]]
        tendon["tension_limits"] = [0.0, 6.0 * size**2]
    # 3.516 sqrt(E I / (m L^4)) by a radius: lengths cancel
    sliding_speed = 3.516 * math.sqrt(MODULUS / DENSITY) * 0.5 * (RADIUS / LENGTH) ** 2
    for share in (0.4, 0.6):
        friction = {"coefficient": 0.2, "stiction_speed": share * sliding_speed}
        text = words_of({**tables, "effects": {"tendon_friction": friction}})
        assert ("stiction_speed" in text) == (share > 0.5), text


def test_scales_are_those_of_a_cantilever():
    scales = scales_of(Scene.parse(silicone_arm(), "arm"))
    mass = DENSITY * AREA * LENGTH
    # S. P. Timoshenko, Vibration Problems in Engineering: omega = 1.8751^2 sqrt(E I / (m L^4))
    rate = 1.8751**2 * math.sqrt(BENDING / (DENSITY * AREA * LENGTH**4))
    assert scales.mass == pytest.approx(mass)
    assert scales.bending == pytest.approx(BENDING)
    assert scales.rate == pytest.approx(rate, rel=1e-3)
    # viscosity 3 eta I beside E I: a retardation time, and half of it times omega
    expected_damping_ratio = 0.5 * rate * 3.0 * 3e3 / MODULUS
    assert scales.damping_ratio == pytest.approx(expected_damping_ratio, rel=1e-3)
    assert scales.modulus == pytest.approx(MODULUS)
    assert scales.pull == 6.0
    assert (scales.length, scales.radius) == (LENGTH, RADIUS)


def swinging_base(frequency):
    return loads("moving_base", amplitude=[1e-9, 0, 0], frequency=frequency)


def swinging_force(frequency):
    signal = {"type": "sine", "frequency": frequency}
    return loads("disturbance", loads=[{"at": LENGTH, "force": [0, 1e-4, 0], "signal": signal}])


@pytest.mark.parametrize("swinging", [swinging_base, swinging_force])
def test_frequencies_may_be_a_thousand_times_the_arm_s_own(swinging):
    rate = scales_of(Scene.parse(silicone_arm(), "arm")).rate
    own_frequency = rate / (2.0 * math.pi)
    assert words_of({**silicone_arm(), **swinging(900.0 * own_frequency)}) == ""
    text = words_of({**silicone_arm(), **swinging(1100.0 * own_frequency)})
    assert "is it rad/s, or 1/min?" in text


FAMILIES = {
    # length [m], radius over length, modulus [Pa], density [kg/m^3], offset over radius
    "silicone": ((0.08, 0.6), (0.02, 0.09), (5e4, 2e6), (950, 1250), (0.5, 0.95)),
    "gel": ((0.03, 0.2), (0.05, 0.12), (1e4, 1e5), (1000, 1050), (0.5, 0.9)),
    "printed": ((0.1, 0.7), (0.01, 0.06), (8e6, 9e7), (1000, 1250), (0.6, 0.95)),
    "trunk": ((1.0, 4.0), (0.03, 0.06), (1e6, 2e7), (900, 1200), (0.6, 0.95)),
    "catheter": ((0.1, 1.2), (1e-3, 3e-3), (4e10, 8e10), (6450, 6500), (0.5, 0.9)),
    "micro": ((1e-3, 6e-3), (0.02, 0.06), (3e5, 4e6), (950, 1300), (0.4, 0.9)),
    "hose": ((4.0, 15.0), (0.005, 0.02), (5e6, 9e7), (1000, 1500), (0.6, 0.95)),
    "backbone": ((0.15, 0.8), (1.5e-3, 4e-3), (6e10, 2.1e11), (6450, 7850), (6.0, 14.0)),
    "fibre": ((0.2, 1.0), (2e-3, 6e-3), (3e10, 5e10), (1800, 2000), (3.0, 12.0)),
    "foam": ((0.2, 1.5), (0.03, 0.1), (2e4, 5e5), (25, 200), (0.6, 0.95)),
}
DRAWS = 6


def drawn_arm(family, seed):
    """Tables of an arm that somebody may have built."""
    random = np.random.default_rng([seed, *family.encode()])

    def between(ends):
        return float(np.exp(random.uniform(*np.log(ends))))

    length, share, E, density, outside = map(between, FAMILIES[family])
    radius = share * length
    count = int(random.integers(1, 13))
    bending = E * math.pi * radius**4 / 4.0
    rate = 3.516 * math.sqrt(bending / (density * math.pi * radius**2 * length**4))
    damping = 2.0 * between((0.003, 2.0)) / rate * E / 3.0
    offset = outside * radius
    limit = between((0.5, 5.0)) * bending / (offset * length)  # bends by so many radians
    segment = {"length": length, "radius": radius, "young_modulus": E, "density": density}
    segment |= {"poisson_ratio": float(random.uniform(0.25, 0.5)), "damping": damping}
    effects = {}
    mass = density * math.pi * radius**2 * length
    if family in ("backbone", "fibre"):
        disc = {"number": int(random.integers(6, 20)), "radius": 1.2 * offset}
        disc["thickness"] = 0.2 * offset
        disc["mass"] = between((900, 2800)) * math.pi * disc["radius"] ** 2 * disc["thickness"]
        segment["discs"] = disc
        mass += disc["number"] * disc["mass"]
    tendons = []
    for k in range(count):
        angle = 360.0 * k / count + float(random.uniform(0, 30))
        place = [offset * math.cos(math.radians(angle)), offset * math.sin(math.radians(angle))]
        routing = {"type": "straight", "offset": place}
        if outside < 1.0 and random.random() < 0.2:
            turns = random.uniform(0.2, 2.0)
            rate_of_helix = min(2.0 * math.pi * turns / length, 1.0 / offset)
            routing = {"type": "helix", "radius": offset, "angular_rate": rate_of_helix}
            routing["phase"] = angle
        tendons.append({"routing": routing, "tension_limits": [0.0, limit]})
    if random.random() < 0.6:
        effects["gravity"] = {"acceleration": [0.0, 0.0, -9.81]}
    if random.random() < 0.5:
        effects["tip_load"] = {"mass": between((0.02, 2.0)) * mass}
    if random.random() < 0.3:
        effects["fluid"] = {"density": 1.2 if random.random() < 0.5 else 1025.0}
    if random.random() < 0.4:
        effects["actuators"] = {"time_constant": between((0.005, 0.3)), "delay": 0.02}
        effects["actuators"]["rate_limit"] = between((0.3, 50.0)) * limit
    if random.random() < 0.4:
        effects["tendon_friction"] = {"coefficient": between((0.03, 0.8))}
    if random.random() < 0.3:
        floor = {"type": "plane", "position": [0, 0, -length], "axis": [0, 0, 1]}
        effects["contact"] = {"obstacles": [floor], "friction": 0.6}
    turn = [0.0, float(random.choice([0, 30, 45, 90, 120, 180])), 0.0]
    return {
        "name": family,
        "segments": [segment],
        "tendons": tendons,
        "effects": effects,
        "base": {"rotation": turn},
    }


@pytest.mark.parametrize("family", FAMILIES)
def test_arms_as_people_build_them_get_no_word(family):
    told = [words_of(drawn_arm(family, seed)) for seed in range(DRAWS)]
    assert told == [""] * DRAWS


def said_of_options(**options):
    """What is said of options of an environment on the silicone arm."""
    scene = Scene.parse(silicone_arm(), "arm")
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        warn_of_options(Options.parse(options, "environment"), scene)
    return " ".join(str(warning.message) for warning in caught)


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"randomize": {"latency": 30}}, "randomize.latency is 30, 30 s: is it ms?"),
        ({"randomize": {"latency": (0.0, 15.0)}}, "is it ms?"),
        ({"control_period": 10, "preview": [20.0]}, "control_period is 10, 10 s: is it ms?"),
        ({"preview": [100.0, 200.0], "control_period": 0.05}, "preview is 200"),
        ({"randomize": {"noise": {"position": 0.5}}}, "1.25 of the arm's length: is it mm?"),
        ({"randomize": {"noise": {"length": 0.3}}}, "randomize.noise.length"),
        ({"randomize": {"noise": {"rotation": 0.5}}}, "rad: is it deg?"),
        ({"randomize": {"noise": {"curvature": 20.0}}}, "deg/m"),
        ({"randomize": {"noise": {"stretch": 0.5}}}, "%"),
        ({"randomize": {"tension_offset": (-100.0, 50.0)}}, "tension_offset is 100, 16.7 of the"),
        ({"randomize": {"payload": (0.0, 20.0)}}, "randomize: effects.tip_load.mass is 20"),
        ({"tension_rate": 0.05}, "N/ms"),
        ({"threshold": 4.0}, "threshold is 4, 10 lengths of the arm: is it mm?"),
        ({"tip_speed_limit": 800.0}, "mm/s"),
    ],
)
def test_options_in_other_units_get_a_word(options, words):
    assert words in said_of_options(**options)


@pytest.mark.parametrize(
    "options",
    [
        {},
        {"control_period": 2.5, "preview": [2.5, 25.0]},
        {"randomize": {"latency": (0.0, 0.2), "stiffness": (0.5, 2.0), "payload": (0.0, 0.05)}},
        {"randomize": {"noise": {"position": 0.01, "rotation": 0.05, "curvature": 0.2}}},
        {"randomize": {"tension_offset": 0.5}, "tension_rate": 5.0, "threshold": 0.02},
        {"tip_speed_limit": 20.0, "preview": [0.5, 1.0]},
    ],
)
def test_usual_options_get_none(options):
    assert said_of_options(**options) == ""


def test_memory_is_told_before_it_is_taken():
    with (
        pytest.warns(UnitsWarning, match=r"10,000,000,000 rows take at least .* GiB of memory"),
        pytest.raises(MemoryError, match="make fewer"),
    ):
        warn_of_memory(10**10, 1000)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        warn_of_memory(64, 1000)
