"""Plausible sizes of a scene's numbers, as shares of the arm: BOUNDS is the table of them.

A number in another unit than SI's is off by a factor of 57 (degrees), 1,000 (mm, g, ms, kPa) or
1e6 (N mm^2), which hardly any arm makes up for. Each bound leaves room for arms that exist.
"""

import math
from collections.abc import Iterator
from typing import Any, NamedTuple

import numpy as np

from soft_tendon_env.effects.actuation import Actuators
from soft_tendon_env.effects.loads import TipLoad
from soft_tendon_env.scene.routing import HelixRouting, SurfaceRouting
from soft_tendon_env.scene.scene import (
    Scene,
    Segment,
    Tendon,
    along_rod,
    disc_rows,
    rod_length,
    rod_radius,
    tendon_ends,
    tendon_offset,
)
from soft_tendon_env.scene.sections import Discs, Stiffness
from soft_tendon_env.tools.types import Array, Triple

PLACES = 9
"""Places along the rod at which it is looked at."""

GRAVITY = 9.81
"""Acceleration [m/s^2] by which payloads weigh."""

HEAVY = 2.0
"""Weights of the arm above which a force at its tip should not bend it without end."""

FIRST_MODE = 3.516
"""Square of the first root of 1 + cos(x) cosh(x) = 0: the first frequency of a cantilever is this
times sqrt(E I / (m L^4))."""

RADIANS = tuple(math.pi * share for share in (1 / 6, 1 / 4, 1 / 3, 1 / 2, 2 / 3, 3 / 4, 1.0))
"""Angles [rad] that a user writes as such: usual parts of a turn."""

MORE_RADIANS = tuple(math.pi * share for share in (7 / 6, 5 / 4, 4 / 3, 3 / 2, 5 / 3, 7 / 4, 2.0))
"""Angles [rad] above half a turn, likewise."""

SAME_ANGLE = 1.5e-3
"""Relative difference of an angle to one of those: of pi with three digits."""

SOFT = 1e7
"""Modulus [Pa] of rubbers."""

SLENDER = 0.01
"""Share of its length that the radius of a soft body is at least; thinner ones are backbones."""


class Bound(NamedTuple):
    """Range of a number as a share of something of the arm."""

    least: float
    greatest: float
    share: str  # of what, after the value
    question: str


BOUNDS = {
    # sections that are stiffnesses: no section has its material beyond its outer circle
    "gyration": Bound(1e-3, 1.5, "radii, its radius of gyration", "is it N mm^2?"),
    "torsion": Bound(1e-4, 1e4, "of the bending stiffness", "is it N mm^2?"),
    "shear": Bound(1e-6, 1e3, "of the stretch stiffness", "is it kN?"),
    "line density": Bound(0.1, 25e3, "kg/m^3 of its outer circle", "is it g/m?"),
    "rotary inertia": Bound(0.0, 4.0, "radii, its radius of gyration", "is it g mm?"),
    # material: shipped arms have damping ratios up to 0.8, gels a few
    "damping ratio": Bound(
        0.0, 10.0, "of critical damping in the slowest vibration", "is it kPa s, or ms?"
    ),
    "Poisson's ratio": Bound(0.05, 0.5, "", "is it a part of 1? Rubbers have 0.4 to 0.5"),
    # geometry
    "bow": Bound(0.0, 0.9, "of the curvature at which the rod meets itself", "is it deg/m?"),
    "coil": Bound(0.0, 6.0, "turns of the stress-free rod", "is it deg/m?"),
    "radians": Bound(0.0, 0.5, "", "is it rad? It should be degrees"),
    "helix slope": Bound(0.0, 2.5, "of the slope of 45 degrees", "is it deg/m?"),
    "helix turns": Bound(0.0, 8.0, "turns along the arm", "is it deg/m?"),
    "outside": Bound(0.0, 3.0, "radii of a soft rod from its axis, without discs", "is it mm?"),
    "disc density": Bound(0.0, 25e3, "kg/m^3, if it is as thick as wide", "is it g?"),
    "disc thickness": Bound(0.0, 0.5, "of the rod's length", "is it mm?"),
    # loads
    "payload": Bound(0.0, 50.0, "of the arm's mass", "is it g?"),
    "sag": Bound(0.0, 30.0, "rad that it would bend a linear arm by", "is it g, mN or N mm?"),
    "tip inertia": Bound(0.0, 10.0, "of the arm's mass times squared length", "is it g mm^2?"),
    "gravity": Bound(0.0, 100.0, "m/s^2", "is it mm/s^2, or cm/s^2?"),
    "gravity in g": Bound(0.0, 0.5, "", "is it in units of 9.81 m/s^2?"),
    "motion of the base": Bound(0.0, 1e3, "m/s^2 at the base or the tip", "is it deg, or mm?"),
    "swing": Bound(0.0, 20.0, "lengths of the arm", "is it mm?"),
    "turn": Bound(0.0, 2.0 * math.pi, "rad", "is it deg?"),
    "frequency": Bound(0.0, 1e3, "of the arm's slowest vibration", "is it rad/s, or 1/min?"),
    # actuation
    "lag": Bound(0.0, 3.0, "s", "is it ms?"),
    "rate limit": Bound(5e-3, math.inf, "of the tension limit in a second", "is it N/ms?"),
    "tendon stiffness": Bound(0.05, 1e9, "of the arm's, as the tendon meets it", "is it N/mm?"),
    "displacement": Bound(0.0, 1.0, "lengths of the arm", "is it mm?"),
    "friction": Bound(0.0, 3.0, "", "is it %?"),
    "stiction speed": Bound(
        0.0, 0.5, "of the speed at which its tendons slide in the slowest vibration", "is it mm/s?"
    ),
    # surroundings
    "fluid": Bound(0.02, 20e3, "kg/m^3", "is it g/cm^3?"),
    "water": Bound(0.0, 0.5, "", "is it g/cm^3? Water has 1000 kg/m^3"),
    "current": Bound(0.0, 50.0, "m/s", "is it mm/s?"),
    "distance": Bound(0.0, 100.0, "lengths of the arm from its base", "is it mm?"),
    "obstacle": Bound(0.0, 500.0, "lengths of the arm", "is it mm?"),
    # computation
    "step": Bound(0.0, 1.0, "s", "is it ms?"),
    "tolerance": Bound(0.0, 0.1, "lengths of the arm", "is it mm?"),
}
"""Plausible ranges by name. "Water", "radians" and "gravity in g" count 1 where a number is one of
another unit's usual ones."""


class Quantity(NamedTuple):
    """Number of a scene, and the share of the arm that it is."""

    bound: str  # name in BOUNDS
    key: str
    value: float
    share: float


class ArmScales(NamedTuple):
    """Sizes of an arm, of which others are shares."""

    length: float  # [m]
    radius: float  # largest of the rod [m]
    mass: float  # of rod and discs [kg]
    bending: float  # median E I about the softer axis [N m^2]
    rate: float  # of the slowest vibration of the bare rod [rad/s]
    pull: float  # greatest tension [N]
    damping_ratio: float  # of that vibration
    modulus: float  # median of E A over the area of the outer circle [Pa]


def scales_of(scene: Scene) -> ArmScales:
    """Sizes of a scene's arm."""
    length = rod_length(scene)
    places = _middles_of_parts(0.0, length)
    bending, viscous_bending, stretch, line_mass = along_rod(scene, places, _rod_numbers)
    radius, _ = rod_radius(scene, places)
    disc_mass = disc_rows(scene)[:, 1]
    rod_mass = line_mass.mean() * length
    mass = float(rod_mass + disc_mass.sum())
    stiffness = float(np.median(bending))
    mean_line_mass = mass / length
    inertia = mean_line_mass * length**4
    rate = FIRST_MODE * math.sqrt(stiffness / inertia)
    # of Kelvin and Voigt's damping: half the angular frequency times the retardation time
    retardation_times = viscous_bending / bending
    longest_time = np.max(retardation_times)
    damping_ratio = float(0.5 * rate * longest_time)
    area = np.pi * radius**2
    moduli = stretch / area
    limits = [abs(limit) for tendon in scene.tendons for limit in tendon.tension_limits]
    return ArmScales(
        length,
        radius=float(radius.max()),
        mass=mass,
        bending=stiffness,
        rate=rate,
        pull=max(limits),
        damping_ratio=damping_ratio,
        modulus=float(np.median(moduli)),
    )


def _middles_of_parts(start: float, end: float) -> Array:
    """Middles (PLACES,) [m] of equal parts between two arc lengths [m]."""
    numbers = np.arange(PLACES) + 0.5
    shares = numbers / PLACES
    return start + (end - start) * shares


def _rod_numbers(segment: Segment, places: Array) -> Array:
    """Stiffnesses, viscosity and mass of the rod at places (m,) of a segment: (4, m).

    They are bending stiffness about the softer axis [N m^2] and its viscosity, stretch stiffness
    [N] and mass per length [kg/m].
    """
    elasticity, viscosity, inertia = segment.screw_matrices(places)
    softer = 1 + elasticity[1:3].argmin(axis=0)
    column = np.arange(places.size)
    bending = elasticity[softer, column]
    viscous_bending = viscosity[softer, column]
    stretch = elasticity[3]
    line_mass = inertia[3]
    return np.stack([bending, viscous_bending, stretch, line_mass])


def implausible(scene: Scene) -> Iterator[str]:
    """Numbers of a scene outside of BOUNDS, in words, the first of each bound.

    Args:
        scene: of an arm whose length, radius and modulus are plausible.
    """
    named_bounds = set[str]()
    for quantity in _quantities(scene, scales_of(scene)):
        bound = BOUNDS[quantity.bound]
        size = abs(quantity.share)
        is_outside = not bound.least <= size <= bound.greatest
        if not is_outside or quantity.bound in named_bounds:
            continue
        named_bounds.add(quantity.bound)
        share = ""
        if bound.share:
            share = f", {size:.3g} {bound.share}"
        value_and_share = f"{quantity.value:g}{share}"
        yield f"{quantity.key} is {value_and_share}: {bound.question}"


def _quantities(scene: Scene, arm: ArmScales) -> Iterator[Quantity]:
    """Numbers of a scene that have a bound."""
    for i, segment in enumerate(scene.segments):
        yield from _of_segment(segment, f"segments[{i}]", arm)
    yield Quantity("damping ratio", _damping_key(scene), _damping(scene), arm.damping_ratio)
    for i, tendon in enumerate(scene.tendons):
        yield from _of_tendon(scene, tendon, f"tendons[{i}]", arm)
    yield from _of_angles("base.rotation", scene.base.rotation)
    yield from _of_loads(scene, arm)
    yield from _of_base_motion(scene, arm)
    yield from _of_actuation(scene, arm)
    yield from _of_surroundings(scene, arm)
    step = scene.integrator.step
    yield Quantity("step", "integrator.step", step, step)
    tolerance = scene.integrator.tolerance or 0.0
    share = tolerance / arm.length
    yield Quantity("tolerance", "integrator.tolerance", tolerance, share)


def _damping(scene: Scene) -> float:
    """Damping of the first segment, a viscosity [Pa s] or a retardation time [s]."""
    segment = scene.segments[0]
    if isinstance(segment.section, Stiffness):
        return segment.section.retardation_time
    return segment.damping or 0.0


def _damping_key(scene: Scene) -> str:
    """Key of that number."""
    section = scene.segments[0].section
    if isinstance(section, Stiffness):
        return "segments[0].section.retardation_time"
    return "segments[0].damping"


def _of_segment(segment: Segment, key: str, arm: ArmScales) -> Iterator[Quantity]:
    """Material, shape at rest and discs of a segment."""
    section = segment.section
    if isinstance(section, Stiffness):
        yield from _of_stiffness(section, segment.length, f"{key}.section")
    ratio = segment.poisson_ratio
    # 0 is written on purpose
    if ratio:
        not_negative = max(ratio, 0.0)
        yield Quantity("Poisson's ratio", f"{key}.poisson_ratio", ratio, not_negative)
    torsion, *bends = segment.curvature
    curvature = math.hypot(*bends)
    curvature_key = f"{key}.curvature"
    bow = curvature * arm.radius
    yield Quantity("bow", curvature_key, curvature, bow)
    total = math.hypot(torsion, curvature)
    turned_angle = total * segment.length
    turns = turned_angle / (2.0 * math.pi)
    yield Quantity("coil", curvature_key, total, turns)
    if segment.discs is not None:
        yield from _of_discs(segment.discs, f"{key}.discs", arm)


def _of_discs(discs: Discs, key: str, arm: ArmScales) -> Iterator[Quantity]:
    """Mass and thickness of spacer discs."""
    width = 2.0 * discs.radius
    thickness = discs.thickness or width
    square_radius = discs.radius**2
    volume = math.pi * square_radius * thickness
    disc_density = discs.mass / volume
    yield Quantity("disc density", f"{key}.mass", discs.mass, disc_density)
    share = 0.0
    if discs.thickness:
        share = discs.thickness / arm.length
    yield Quantity("disc thickness", f"{key}.thickness", thickness, share)


def _of_stiffness(section: Stiffness, length: float, key: str) -> Iterator[Quantity]:
    """Numbers of a section that are stiffnesses, beside each other and its radius."""
    shares = np.array([0.0, 0.5, 1.0])
    places = length * shares
    radii, _ = section.outer_radius(places, length)
    radius = float(np.median(radii))
    for stiffness in section.bending:
        # E I / (E A) is the square of the radius of gyration
        gyration = math.sqrt(stiffness / section.stretch)
        yield Quantity("gyration", f"{key}.bending", stiffness, gyration / radius)
    softer = min(section.bending)
    torsion = section.torsion
    yield Quantity("torsion", f"{key}.torsion", torsion, torsion / softer)
    for stiffness in section.shear:
        share = stiffness / section.stretch
        yield Quantity("shear", f"{key}.shear", stiffness, share)
    mass = section.mass_per_length
    area = math.pi * radius**2
    yield Quantity("line density", f"{key}.mass_per_length", mass, mass / area)
    if section.rotary_inertia is not None:
        for inertia in section.rotary_inertia:
            gyration = math.sqrt(inertia / mass)
            share = gyration / radius
            yield Quantity("rotary inertia", f"{key}.rotary_inertia", inertia, share)


def _of_tendon(scene: Scene, tendon: Tendon, key: str, arm: ArmScales) -> Iterator[Quantity]:
    """Place and angles of a tendon."""
    start, end = tendon_ends(scene, tendon)
    routing = tendon.routing
    if isinstance(routing, HelixRouting):
        name = f"{key}.routing.angular_rate"
        rate = routing.angular_rate
        slope = rate * routing.radius
        turned_angle = rate * (end - start)
        turns = turned_angle / (2.0 * math.pi)
        yield Quantity("helix slope", name, rate, slope)
        yield Quantity("helix turns", name, rate, turns)
        yield from _of_angles(f"{key}.routing.phase", (routing.phase,))
    if isinstance(routing, SurfaceRouting):
        yield from _of_angles(f"{key}.routing.angle", (routing.angle,))
    # tendons of backbones run through discs, which a scene need not have, and those of soft
    # bodies inside of them
    has_discs = bool(disc_rows(scene).size)
    slender_radius = SLENDER * arm.length
    is_thick = arm.radius > slender_radius
    is_soft = arm.modulus < SOFT and is_thick
    if is_soft and not has_discs:
        places = _middles_of_parts(start, end)
        offsets, _ = tendon_offset(scene, tendon, places)
        radius, _ = rod_radius(scene, places)
        distance = np.linalg.norm(offsets, axis=1)
        farthest = float(distance.max())
        shares = distance / radius
        largest_share = float(shares.max())
        yield Quantity("outside", f"{key}.routing", farthest, largest_share)


def _of_angles(key: str, angles: tuple[float, ...]) -> Iterator[Quantity]:
    """Angles in degrees: 1 where the size of one is a usual part of a turn in radians."""
    usual = np.array(RADIANS + MORE_RADIANS)
    for angle in angles:
        from_usual = abs(angle) - usual
        difference = np.abs(from_usual)
        is_usual = difference <= SAME_ANGLE * usual
        is_any_usual = float(is_usual.any())
        yield Quantity("radians", key, angle, is_any_usual)


def _of_loads(scene: Scene, arm: ArmScales) -> Iterator[Quantity]:
    """Gravity, payloads, forces and moments."""
    effects = scene.effects
    if effects.gravity is not None:
        key = "effects.gravity.acceleration"
        size = math.hypot(*effects.gravity.acceleration)
        yield Quantity("gravity", key, size, size)
        is_one = abs(size - 1.0) <= 0.02
        yield Quantity("gravity in g", key, size, float(is_one))
    if effects.tip_load is not None:
        yield from _of_tip_load(effects.tip_load, arm)
    if effects.disturbance is not None:
        for i, load in enumerate(effects.disturbance.loads):
            key = f"effects.disturbance.loads[{i}]"
            yield from _of_wrench(load.force, load.moment, key, arm)
            yield from _of_signal(load.signal, f"{key}.signal", arm)


def _of_tip_load(load: TipLoad, arm: ArmScales) -> Iterator[Quantity]:
    """Payload, force and moment at the tip."""
    key = "effects.tip_load"
    mass = load.mass
    mass_share = mass / arm.mass
    yield Quantity("payload", f"{key}.mass", mass, mass_share)
    weight = GRAVITY * mass
    sag = _sag(weight, arm)
    yield Quantity("sag", f"{key}.mass", mass, sag)
    yield from _of_wrench(load.force, load.moment, key, arm)
    inertia = max(load.inertia)
    heavier = max(arm.mass, mass)
    whole = heavier * arm.length**2
    yield Quantity("tip inertia", f"{key}.inertia", inertia, inertia / whole)


def _of_wrench(force: Triple, moment: Triple, key: str, arm: ArmScales) -> Iterator[Quantity]:
    """Force [N] and moment [N m] on the arm."""
    force_size = math.hypot(*force)
    sag = _sag(force_size, arm)
    yield Quantity("sag", f"{key}.force", force_size, sag)
    moment_size = math.hypot(*moment)
    bent = moment_size * arm.length / arm.bending  # [rad] by M l / (E I)
    yield Quantity("sag", f"{key}.moment", moment_size, bent)


def _sag(force: float, arm: ArmScales) -> float:
    """Angle [rad] by which a force [N] at the tip would bend a linear cantilever.

    It is 0 for forces like the arm's own weight, by which a gel may hang.
    """
    own_weight = GRAVITY * arm.mass
    if force < HEAVY * own_weight:
        return 0.0
    # F l^2 / (2 E I)
    doubled_bending = 2.0 * arm.bending
    return force * arm.length**2 / doubled_bending


def _of_signal(signal: Any, key: str, arm: ArmScales) -> Iterator[Quantity]:
    """Frequency and phase of what swings."""
    # not every signal has a frequency and a phase
    frequency = getattr(signal, "frequency", 0.0)
    phase = getattr(signal, "phase", 0.0)
    rate = 2.0 * math.pi * frequency
    rate_share = rate / arm.rate
    yield Quantity("frequency", f"{key}.frequency", frequency, rate_share)
    yield from _of_angles(f"{key}.phase", (phase,))


def _of_base_motion(scene: Scene, arm: ArmScales) -> Iterator[Quantity]:
    """Motion of the base: its accelerations at the base, or at the tip of a straight arm."""
    motion = scene.effects.moving_base
    if motion is None:
        return
    key = "effects.moving_base"
    rate = 2.0 * math.pi * motion.frequency
    acceleration = math.hypot(*motion.acceleration)
    yield Quantity("motion of the base", f"{key}.acceleration", acceleration, acceleration)
    amplitude = math.hypot(*motion.amplitude)
    acceleration_size = rate**2 * amplitude
    yield Quantity("motion of the base", f"{key}.amplitude", amplitude, acceleration_size)
    amplitude_share = amplitude / arm.length
    yield Quantity("swing", f"{key}.amplitude", amplitude, amplitude_share)
    velocity = math.hypot(*motion.velocity)
    yield Quantity("current", f"{key}.velocity", velocity, velocity)
    turning = motion.angular_velocity
    centripetal = turning**2 * arm.length
    yield Quantity("motion of the base", f"{key}.angular_velocity", turning, centripetal)
    swing = motion.angular_amplitude
    yield Quantity("turn", f"{key}.angular_amplitude", swing, swing)
    rate_share = rate / arm.rate
    yield Quantity("frequency", f"{key}.frequency", motion.frequency, rate_share)


def _of_actuation(scene: Scene, arm: ArmScales) -> Iterator[Quantity]:
    """Actuators, elasticity and friction of the tendons."""
    effects = scene.effects
    if effects.actuators is not None:
        yield from _of_actuators(effects.actuators, arm)
    elasticity = effects.tendon_elasticity
    if elasticity is not None:
        key = "effects.tendon_elasticity"
        softest = _stiffness_at_tendons(scene, arm)
        stiffness = elasticity.stiffness
        share = stiffness / softest
        yield Quantity("tendon stiffness", f"{key}.stiffness", stiffness, share)
        for name in ("displacement_limits", "slack"):
            sizes = map(abs, getattr(elasticity, name))
            greatest = max(sizes, default=0.0)
            share = greatest / arm.length
            option = f"{key}.{name}"
            yield Quantity("displacement", option, greatest, share)
    friction = effects.tendon_friction
    if friction is not None:
        key = "effects.tendon_friction"
        coefficient = friction.coefficient
        yield Quantity("friction", f"{key}.coefficient", coefficient, coefficient)
        speed = friction.stiction_speed
        # where a vibration of the arm has an amplitude of a radian
        sliding_speed = arm.radius * arm.rate
        speed_share = speed / sliding_speed
        yield Quantity("stiction speed", f"{key}.stiction_speed", speed, speed_share)


def _of_actuators(actuators: Actuators, arm: ArmScales) -> Iterator[Quantity]:
    """Lags and rates of the actuators."""
    key = "effects.actuators"
    for name in ("time_constant", "delay"):
        value = getattr(actuators, name)
        option = f"{key}.{name}"
        yield Quantity("lag", option, value, value)
    limit = actuators.rate_limit
    if limit is not None and arm.pull:
        limit_share = limit / arm.pull
        yield Quantity("rate limit", f"{key}.rate_limit", limit, limit_share)


def _stiffness_at_tendons(scene: Scene, arm: ArmScales) -> float:
    """Least stiffness [N/m] that a tendon meets: E I / (d^2 l) of the bending arm."""
    stiffnesses = []
    for tendon in scene.tendons:
        start, end = tendon_ends(scene, tendon)
        length = end - start
        places = _middles_of_parts(start, end)
        offset, _ = tendon_offset(scene, tendon, places)
        squared_distance = (offset**2).sum(axis=1)
        mean = float(squared_distance.mean())
        if mean:
            stiffness = arm.bending / (mean * length)
            stiffnesses.append(stiffness)
    return min(stiffnesses, default=math.inf)


def _of_surroundings(scene: Scene, arm: ArmScales) -> Iterator[Quantity]:
    """Fluid and obstacles."""
    fluid = scene.effects.fluid
    if fluid is not None:
        key = "effects.fluid"
        density = fluid.density
        yield Quantity("fluid", f"{key}.density", density, density)
        is_water = 0.95 <= density <= 1.06  # air has 1.1 kg/m^3 and more where people are
        yield Quantity("water", f"{key}.density", density, float(is_water))
        speed = math.hypot(*fluid.current)
        yield Quantity("current", f"{key}.current", speed, speed)
    contact = scene.effects.contact
    if contact is not None:
        friction = contact.friction
        yield Quantity("friction", "effects.contact.friction", friction, friction)
        for i, obstacle in enumerate(contact.obstacles):
            away = np.subtract(obstacle.position, scene.base.position)
            distance = float(np.linalg.norm(away))
            yield from _of_obstacle(obstacle, distance, f"effects.contact.obstacles[{i}]", arm)


def _of_obstacle(obstacle: Any, distance: float, key: str, arm: ArmScales) -> Iterator[Quantity]:
    """Place, size and motion of an obstacle at a distance [m] from the base."""
    distance_share = distance / arm.length
    yield Quantity("distance", f"{key}.position", distance, distance_share)
    # each kind has some of these
    for name in ("radius", "length", "size"):
        value = getattr(obstacle, name, 0.0)
        size = float(np.max(value))
        size_share = size / arm.length
        option = f"{key}.{name}"
        yield Quantity("obstacle", option, size, size_share)
    speed = math.hypot(*obstacle.velocity)
    yield Quantity("current", f"{key}.velocity", speed, speed)
    yield from _of_signal(obstacle, key, arm)
    rotation = getattr(obstacle, "rotation", ())
    yield from _of_angles(f"{key}.rotation", rotation)
