"""Contact of flat sections: nearest points of outlines, forces of a potential, ribbons that roll to
lie flat."""

import numpy as np
import pytest

import soft_tendon_env as ste
from soft_tendon_env.effects.contact import Contact
from soft_tendon_env.effects.contact.obstacles import body_at, distance
from soft_tendon_env.effects.contact.outline import (
    ELLIPSE,
    FLAT,
    RECTANGLE,
    Bracket,
    narrowed,
    nearest,
    root_of_chord,
)
from soft_tendon_env.effects.contact.samples import Sample
from soft_tendon_env.model.contact_forces import contact_forces
from soft_tendon_env.scene.scene import Scene

HALF_Y = 0.012  # [m]
HALF_Z = 0.002  # [m]
SHAPES = {"rectangle": RECTANGLE, "ellipse": ELLIPSE}
TABLE = {"type": "plane", "position": [0.0, 0.0, -0.02]}
CURVED = [
    {"type": "sphere", "position": [0.0, 0.004, -0.05], "radius": 0.045},
    {"type": "sphere", "position": [0.0, 0.006, -0.006], "radius": 0.003},
    {"type": "capsule", "position": [0.0, -0.003, -0.01], "radius": 0.006, "length": 0.1}
    | {"axis": [1.0, 0.2, 0.3]},
    {"type": "box", "position": [0.0, 0.01, -0.01], "size": [0.02, 0.01, 0.015]}
    | {"rotation": [25.0, 10.0, 0.0]},
]
"""Obstacles beside a section in the plane x = 0, with its middle at the origin."""


def body_of(obstacle):
    return body_at(Contact(obstacles=[obstacle]).rows(), 0, 0.0)


def sample_of(shape):
    nothing = dict.fromkeys(Sample._fields, 0.0)
    outline = {"shape": shape, "radius": HALF_Z, "half_y": HALF_Y, "half_z": HALF_Z}
    return Sample(**{**nothing, **outline})


def axes_turned(angle):
    """Axes y and z of a section that is turned about x."""
    c = np.cos(angle)
    s = np.sin(angle)
    return (0.0, c, s), (0.0, -s, c)


def support(shape, angle):
    """Largest extent [m] downwards of a section turned about x."""
    across = HALF_Y * np.sin(angle)
    along = HALF_Z * np.cos(angle)
    if shape == RECTANGLE:
        return abs(across) + abs(along)
    return np.hypot(across, along)


@pytest.mark.no_jit
@pytest.mark.parametrize("name", SHAPES)
def test_on_a_plane_the_gap_is_less_the_support_of_the_section(name):
    body = body_of(TABLE)
    for angle in np.linspace(-3.1, 3.1, 21):
        y_axis, z_axis = axes_turned(angle)
        point = nearest(body, sample_of(SHAPES[name]), (0.1, 0.0, 0.03), y_axis, z_axis)
        exact = 0.05 - support(SHAPES[name], angle)
        assert exact - 1e-12 <= point.gap <= exact + FLAT * HALF_Y
        np.testing.assert_allclose(point.normal, [0.0, 0.0, 1.0], atol=1e-14)


@pytest.mark.no_jit
@pytest.mark.parametrize("name", SHAPES)
@pytest.mark.parametrize("obstacle", CURVED, ids=lambda obstacle: str(obstacle["position"]))
def test_no_other_point_of_the_section_is_nearer(name, obstacle):
    """Beside points of the whole section, evenly in its square of parameters."""
    body = body_of(obstacle)
    to_frame = np.array(body.R).reshape(3, 3).T
    share = np.linspace(-1.0, 1.0, 161)
    y, z = np.meshgrid(HALF_Y * share, HALF_Z * share)
    if SHAPES[name] == ELLIPSE:
        is_inside = (y / HALF_Y) ** 2 + (z / HALF_Z) ** 2 <= 1.0
        y = y[is_inside]
        z = z[is_inside]
    for angle in (0.0, 0.3, 0.9, 1.5):
        y_axis, z_axis = axes_turned(angle)
        point = nearest(body, sample_of(SHAPES[name]), (0.0, 0.0, 0.0), y_axis, z_axis)
        places = np.outer(y.ravel(), y_axis) + np.outer(z.ravel(), z_axis)
        within = (places - body.r) @ to_frame.T
        least = min(distance(body, tuple(place))[0] for place in within[::7])
        assert point.gap <= least + FLAT * HALF_Y
        own, _ = distance(body, tuple(to_frame @ (np.array(point.offset) - body.r)))
        assert own <= point.gap + 1e-12  # it is the distance of a point of the section
        _, place_y, place_z = point.place
        assert abs(place_y) <= HALF_Y + 1e-12
        assert abs(place_z) <= HALF_Z + 1e-12


@pytest.mark.no_jit
@pytest.mark.parametrize("side", [1.0, -1.0])
def test_brackets_close_on_a_root_from_both_sides(side):
    """That of (x + 1)^5 - 2, whose chords all end at the upper end, and of its mirror image, in
    less than 20 chords; one by one from the same end they take more than 100."""
    root = side * (2.0**0.2 - 1.0)

    def value(x):
        return side * ((1.0 + side * x) ** 5 - 2.0)

    bracket = Bracket(-1.0, value(-1.0), 1.0, value(1.0), 0.0)
    for _ in range(20):
        place = root_of_chord(bracket)
        if abs(value(place)) < 1e-12:
            break
        bracket = narrowed(bracket, place, value(place))
        assert bracket.low < root < bracket.high
    assert place == pytest.approx(root, abs=1e-12)


def ribbon(section, obstacles, *, turn=0.0, order=4, **changes):
    """A soft ribbon that is clamped at a height of 20 mm above the table, under gravity."""
    table = {
        "name": "ribbon",
        "base": {"rotation": [turn, 0.0, 0.0]},
        "segments": [
            {
                "length": 0.22,
                "section": section,
                "young_modulus": 8e6,
                "poisson_ratio": 0.4,
                "density": 1200.0,
                "damping": 1e5,
            }
        ],
        "tendons": [
            {"routing": {"type": "straight", "offset": [0.0, 0.0005]}, "tension_limits": [0.0, 1.0]}
        ],
        "strain": {
            "type": "explicit",
            "modes": [{"strains": ["torsion", "bend_y", "bend_z"], "order": order, "span": "rod"}],
        },
        "effects": {
            "gravity": {"acceleration": [0.0, 0.0, -9.81]},
            "contact": {"obstacles": obstacles, **changes},
        },
    }
    return ste.build_model(Scene.parse(table, "ribbon"), fidelity="scene")


FLAT_SECTIONS = [
    {"type": "rectangle", "width": 0.024, "height": 0.0016},
    {"type": "ellipse", "width": 0.02, "height": 0.0018},
    {"type": "rectangle", "width": 0.002, "height": 0.022},
]


@pytest.mark.parametrize("section", FLAT_SECTIONS, ids=str)
@pytest.mark.parametrize("turn", [0.0, 12.0])
def test_a_ribbon_lies_flat_on_a_table(section, turn):
    """Its axis is half of the least width above the table; one that hangs tilted rolls to lie flat:
    its weight on the edge turns it."""
    is_upright = section["width"] < section["height"]
    model = ribbon(section, [TABLE], turn=turn + 90.0 * is_upright)
    rest = ste.static_equilibrium(model, np.zeros(1))
    assert rest.converged
    least = min(section["width"], section["height"])
    height = rest.tip_pose[2, 3] + 0.02
    assert height == pytest.approx(0.5 * least, abs=0.1 * least)
    wide = rest.tip_pose[:3, 2 if is_upright else 1]
    assert abs(np.degrees(np.arcsin(wide[2]))) < 1.0


def test_forces_of_flat_sections_are_those_of_a_potential():
    """F = -dV/dq at rest, where faces, edges and a round obstacle touch."""
    obstacles = [
        {"type": "plane", "position": [0.0, 0.0, -0.0005], "axis": [0.0, 0.1, 1.0]},
        {"type": "sphere", "position": [0.2, 0.006, 0.0505], "radius": 0.05},
    ]
    model = ribbon(FLAT_SECTIONS[0], obstacles)
    n = model.coordinate_count
    rng = np.random.default_rng(3)
    q = 1e-3 * model.coordinate_scale() * rng.standard_normal(n)
    still = np.zeros(n)
    falls = []
    for i, size in enumerate(1e-6 * model.coordinate_scale()):
        way = np.zeros(n)
        way[i] = size
        ahead = model.energy(q + way, still).load
        behind = model.energy(q - way, still).load
        fall = (behind - ahead) / (2.0 * size)
        falls.append(fall)
    force = model.terms(q, still).external_force
    scale = model.coordinate_scale()
    assert np.abs(force * scale).max() > 1e-3
    np.testing.assert_allclose(
        force * scale, np.array(falls) * scale, atol=2e-3 * np.abs(force * scale).max()
    )


def test_a_tilted_ribbon_falls_flat():
    """The sum of kinetic energy, and those of elasticity, gravity and contact, never grows."""
    model = ribbon(FLAT_SECTIONS[0], [TABLE], turn=25.0, friction=0.3)
    simulation = ste.Simulation(model)
    energies = []
    for _ in range(40):
        simulation.step(np.zeros(1), 0.02)
        state = simulation.state
        energy = model.energy(state.q, state.q_dot).total
        energies.append(energy)
    clearance = contact_forces(model, simulation.state).clearance[0]
    assert -2e-4 < clearance < 1e-4
    assert abs(np.degrees(np.arcsin(simulation.tip_pose[2, 1]))) < 1.0
    fallen = energies[0] - energies[-1]
    assert np.diff(energies).max() < 1e-6 * fallen
