"""From a scene to the rod's arrays and its coordinates: intervals and points, weights, sections;
passive and Legendre fields."""

import numpy as np
import pytest

from soft_tendon_env.mechanics.algebra.lanes import LANES
from soft_tendon_env.model.coordinates import (
    coordinate_count,
    independent_tensions,
    make_strain,
)
from soft_tendon_env.model.grid import (
    LARGEST_PANEL,
    actuation_columns,
    at_points,
    chords,
    disc_inertia,
    make_grid,
    make_rod,
    newton_cotes,
    over_nodes,
    screw_matrices,
)
from soft_tendon_env.model.model import model_on
from soft_tendon_env.scene.file import load_scene, scene_names
from soft_tendon_env.scene.scene import rod_length
from soft_tendon_env.scene.strain import Modes, mode_fields

ANGULAR = ("torsion", "bend_y", "bend_z")


def grid_of(name, intervals):
    scene = load_scene(name)
    return scene, make_grid(scene, intervals)


@pytest.mark.parametrize("intervals", [1, 2, 3, 6])
@pytest.mark.parametrize("name", scene_names())
def test_intervals_fill_the_rod_and_none_crosses_a_breakpoint(name, intervals):
    scene, grid = grid_of(name, intervals)
    start = grid.start[grid.real]
    end = (grid.start + grid.length)[grid.real]
    assert start[0] == 0
    assert grid.start.size % LANES == 0
    ends_before = end[:-1]
    np.testing.assert_allclose(start[1:], ends_before, rtol=1e-15)
    np.testing.assert_allclose(end[-1], rod_length(scene), rtol=1e-15)
    assert not grid.length[~grid.real].any()
    pieces = grid.breakpoints.size - 1
    assert grid.real.sum() == intervals * pieces
    for border in grid.breakpoints:
        begins_before = start < border - 1e-12
        ends_after = end > border + 1e-12
        assert not (begins_before & ends_after).any()
    assert (
        (grid.points[grid.real] > start[:, None]) & (grid.points[grid.real] < end[:, None])
    ).all()
    is_inside = grid.points <= rod_length(scene)
    assert ((grid.points >= 0) & is_inside).all()


def test_node_inertia_sums_to_the_rod_without_the_base_node_and_takes_up_the_payload():
    scene, grid = grid_of("paper", 6)
    payload = {"effects.tip_load.mass": 0.3, "effects.tip_load.inertia": [1e-3, 2e-3, 3e-3]}
    carrying = scene.replace(payload)
    bare = make_rod(scene, grid, at_points(scene, grid))
    loaded = make_rod(carrying, grid, at_points(carrying, grid))
    density = 100.0  # of the rod, whose radius goes from 3 to 2 cm [kg/m^3]
    half_weight = 0.5 * newton_cotes(6)[0]
    base_share = half_weight * density * np.pi * 0.03**2
    squares = 0.03**2 + 0.03 * 0.02 + 0.02**2
    frustum = np.pi * squares / 3
    mass = bare.mass + base_share
    np.testing.assert_allclose(mass, density * frustum, rtol=1e-12)
    of_discs = loaded.inertia - bare.inertia
    difference = of_discs.reshape(grid.packs, 6, LANES)
    at_tip = difference[-1, :, -1]
    np.testing.assert_allclose(at_tip, [1e-3, 2e-3, 3e-3, 0.3, 0.3, 0.3], rtol=1e-12)
    assert np.count_nonzero(difference) == 6


def test_helical_tendons_turn_by_the_curvature_of_a_helix_over_their_own_length():
    """A helix of radius r and rate w has the curvature r w^2 / (1 + r^2 w^2) of its path."""
    scene, grid = grid_of("paper", 96)
    turn = at_points(scene, grid).rod.tendon_turn
    rate = 4.0 * np.pi
    for tendons, radius, length in (((3, 4), 0.02, 1.0), ((8, 9), 0.025, 0.5)):
        root = np.sqrt(1.0 + (radius * rate) ** 2)
        expected = radius * rate**2 / root * length
        np.testing.assert_allclose(turn[[*tendons]], expected, rtol=0.01)
    straight = [0, 1, 2, 5, 6, 7]
    assert turn[straight].max() < 0.1


@pytest.mark.parametrize("name", ["paper", "three_tendon"])
@pytest.mark.parametrize("lead", [(), (3,), (2, 3)])
def test_packed_and_unpacked_are_inverse(name, lead):
    """Strains at the points survive the kernels' layout, whatever axes lead; empty intervals get
    the last point's."""
    _, grid = grid_of(name, 3)
    rng = np.random.default_rng(0)
    point_count = 2 * grid.real.sum()
    strain = rng.normal(size=(*lead, point_count, 6))
    packed = grid.packed(strain)
    nodes = 2 * grid.length.size
    assert packed.shape == (*lead, nodes * 6)
    np.testing.assert_array_equal(grid.unpacked(packed), strain)
    by_interval = grid.at_points(packed, 6)
    empty = by_interval[..., ~grid.real, :, :]
    last = strain[..., None, -1:, :]
    expected_empty = np.broadcast_to(last, empty.shape)
    np.testing.assert_array_equal(empty, expected_empty)


def scene_and_grid(name, **changes):
    scene = load_scene(name).replace(changes)
    return scene, make_grid(scene, 4)


def inner(left, right, scene, grid):
    """int left^T Sigma^-1 right dX."""
    elasticity = screw_matrices(scene, grid.points.ravel())[0]
    compliance = 1 / elasticity.reshape(*grid.points.shape, 6)
    weighted = compliance * grid.weights[..., None]
    return np.einsum("imzc,mzc,jmzc->ij", left, weighted, right)


def passive_fields(strain, grid):
    return (
        strain.passive.reshape(-1, grid.packs, 2, 6, LANES)
        .transpose(0, 1, 4, 2, 3)
        .reshape(-1, *grid.points.shape, 6)
    )


@pytest.mark.parametrize(
    ("order", "span", "count"), [(0, "piece", 6), (2, "rod", 9), (3, "rod", 12)]
)
def test_orthogonal_passive_fields(order, span, count):
    """Orthogonal to every actuation field and to each other in compliance, each of unit energy."""
    scene, grid = scene_and_grid(
        "paper", **{"strain.passive": [{"strains": list(ANGULAR), "order": order, "span": span}]}
    )
    stress_free = at_points(scene, grid)
    actuation = stress_free.actuation
    strain = make_strain(scene, grid, stress_free)
    passive = passive_fields(strain, grid)
    assert len(passive) == strain.size - strain.active == count
    np.testing.assert_allclose(
        inner(passive, passive, scene, grid), np.eye(len(passive)), atol=1e-11
    )
    products = inner(actuation, actuation, scene, grid)
    sizes = np.sqrt(np.diag(products))
    np.testing.assert_allclose(
        inner(actuation, passive, scene, grid) / sizes[:, None], 0.0, atol=1e-11
    )


def test_passive_fields_that_the_tendons_span_are_dropped():
    """Three straight tendons span constant bending and stretch exactly; torsion is left."""
    modes = [{"strains": list(ANGULAR), "order": 0, "span": "rod"}]
    scene, grid = scene_and_grid("three_tendon", **{"strain.passive": modes})
    strain = make_strain(scene, grid, at_points(scene, grid))
    assert strain.size == 4
    field = passive_fields(strain, grid)[0][grid.real]
    assert field[..., 0].all()
    largest = np.abs(field[..., 1:]).max()
    bound = 1e-10 * np.abs(field[..., 0]).max()
    assert largest < bound


def test_mode_fields_are_legendre_polynomials_on_their_span():
    scene, grid = scene_and_grid("paper")
    over_rod = mode_fields(
        (Modes(strains=("stretch",), order=2, span="rod"),), grid.points, grid.breakpoints
    )
    x = 2 * grid.points - 1
    np.testing.assert_allclose(
        over_rod[:, ..., 3], [np.ones_like(x), x, (3 * x**2 - 1) / 2], atol=1e-15
    )
    assert not over_rod[..., [0, 1, 2, 4, 5]].any()
    by_piece = mode_fields(
        (Modes(strains=("bend_y", "torsion"), order=1, span="piece"),),
        grid.points,
        grid.breakpoints,
    )
    assert len(by_piece) == 8  # piece, then strain, then order
    second_half = grid.points > 0.5
    np.testing.assert_allclose(
        by_piece[7][..., 0], np.where(second_half, 4 * grid.points - 3, 0.0), atol=1e-15
    )
    np.testing.assert_array_equal(by_piece[4][..., 1], second_half)


HELICES = {
    f"tendons.{i}.routing": {
        "type": "helix",
        "radius": 0.008,
        "angular_rate": 2.0 * np.pi * 12.0 / 0.3,
        "phase": 120.0 * i,
    }
    for i in range(3)
}


@pytest.mark.parametrize(
    ("changes", "count"),
    [
        ({}, 3),
        # three tendons make two of the constant bending fields
        ({"strain.passive": [{"strains": list(ANGULAR), "order": 12, "span": "rod"}]}, 40),
        (
            {
                "strain": {
                    "type": "explicit",
                    "modes": [{"strains": list(ANGULAR), "order": 12, "span": "rod"}],
                }
            },
            39,
        ),
        (HELICES, 3),
    ],
    ids=["tensions", "passive fields", "explicit", "helices"],
)
def test_every_coordinate_is_counted(changes, count):
    """Fields of the highest order, and helices that a coarse quadrature sees as straight."""
    scene = load_scene("three_tendon").replace(changes)
    assert coordinate_count(scene) == count


@pytest.mark.parametrize("intervals", [1, 2, 5, 7, 8, 13, 15])
def test_weights_of_the_nodes_are_positive_and_integrate_the_powers_of_their_panels(intervals):
    """Of the smallest panel all powers, and one more where that is even."""
    weights = newton_cotes(intervals)
    nodes = np.linspace(0.0, 1.0, intervals + 1)
    panels = int(np.ceil(intervals / LARGEST_PANEL))
    smallest = intervals // panels
    assert weights.min() > 0.0
    for power in range(smallest + 1 + (smallest % 2 == 0)):
        exact = 1.0 / (power + 1)
        assert weights @ nodes**power == pytest.approx(exact, rel=1e-12)
    powers = nodes ** (smallest + 2)
    exact_next = 1.0 / (smallest + 3)
    assert abs(weights @ powers - exact_next) > 1e-14


def test_densities_over_the_nodes_add_up_to_integrals_of_every_piece():
    """With a jump between two pieces, of which a node on their border gets both shares."""
    scene, grid = scene_and_grid("paper")

    def density(places):
        density_values = np.where(places < 0.5, 1.0 + places**3, 7.0 * places)
        return np.stack([density_values, places], axis=1)

    total = over_nodes(grid, density)
    assert total.shape == (grid.length.size, 2)
    half_weight = 0.5 * newton_cotes(4)[0]
    density_at_base = density(np.zeros(1))[0]
    at_base = half_weight * density_at_base
    first_half = 0.5 + 0.5**4 / 4
    exact = [first_half + 3.5 * 0.75, 0.5]
    whole = total.sum(axis=0) + at_base
    np.testing.assert_allclose(whole, exact, rtol=1e-12)
    before = 0.5 * newton_cotes(4)[-1] * (1.0 + 0.125)
    after = 0.5 * newton_cotes(4)[0] * 3.5
    border = before + after
    assert total[3, 0] == pytest.approx(border)
    assert not total[~grid.real].any()


def test_places_are_found_in_their_intervals():
    _, grid = scene_and_grid("paper")
    places = np.array([0.0, 0.1, 0.125, 0.3, 0.5, 0.99, 1.0])
    interval, distance = grid.locate(places)
    np.testing.assert_array_equal(interval, [0, 0, 1, 2, 4, 7, 7])
    found_places = grid.start[interval] + distance
    np.testing.assert_allclose(found_places, places, rtol=1e-15)
    found = grid.places(places[:2], places[2:])
    np.testing.assert_array_equal(found.station, interval[:2])
    np.testing.assert_array_equal(found.sensor, interval[2:])
    np.testing.assert_array_equal(found.sensor_distance, distance[2:])


def test_ranges_of_packs_hold_all_parts_of_a_field():
    _, grid = scene_and_grid("paper")
    present = np.zeros((4, 8), dtype=bool)
    present[0, [1, 2]] = present[1, 5] = present[2, [3, 4]] = True
    begin, end = grid.pack_ranges(present)
    assert begin.tolist() == [0, 1, 0, 0]
    assert end.tolist() == [1, 2, 2, 2]


def test_discs_have_the_inertia_of_cylinders():
    rows = np.array([[0.1, 2.0, 0.3, 0.4]])
    about_axis = 2.0 * 0.3**2 / 2
    squares = 3 * 0.3**2 + 0.4**2
    across = 2.0 * squares / 12
    expected = [[about_axis, across, across, 2.0, 2.0, 2.0]]
    np.testing.assert_allclose(disc_inertia(rows), expected)


def test_tendons_of_a_stress_free_arm_are_as_long_as_their_paths():
    """A helix of radius r and rate w: sqrt(1 + r^2 w^2) per length."""
    scene, grid = grid_of("paper", 24)
    lengths = at_points(scene, grid).rod.tendon_length
    rate = 4.0 * np.pi
    helix_length = np.hypot(1.0, 0.02 * rate)
    np.testing.assert_allclose(lengths[3:5], helix_length, rtol=1e-9)
    helix_length = np.hypot(1.0, 0.025 * rate)
    np.testing.assert_allclose(lengths[8:10], 0.5 * helix_length, rtol=1e-9)
    taper = np.hypot(1.0, 0.01)  # of tendons on the surface of a cone
    np.testing.assert_allclose(lengths[[0, 1, 2]], taper, rtol=1e-9)
    np.testing.assert_allclose(lengths[[5, 6, 7]], 0.5 * taper, rtol=1e-9)


def test_independent_tensions_span_those_that_strain_the_rod():
    """Orthonormal combinations, the same whatever the eigenvectors; all where all are
    independent."""
    rng = np.random.default_rng(0)
    columns = rng.normal(size=(4, 9))
    independent = independent_tensions(columns @ columns.T, 1e-3)
    np.testing.assert_array_equal(independent, np.eye(4))
    of_both = columns[0] + columns[1]
    columns[3] = of_both - columns[2]
    mixing = independent_tensions(columns @ columns.T, 1e-3)
    assert mixing.shape == (4, 3)
    product = mixing.T @ mixing
    np.testing.assert_allclose(product, np.eye(3), atol=1e-12)
    # of whatever size the columns are, and with one that strains nothing
    sizes = np.array([1e-5, 1.0, 1e4, 1.0])
    scaled = sizes[:, None] * columns
    mixing = independent_tensions(scaled @ scaled.T, 1e-3)
    assert mixing.shape == (4, 3)
    scaled[3] = 0.0
    mixing = independent_tensions(scaled @ scaled.T, 1e-3)
    np.testing.assert_allclose(np.abs(mixing), np.eye(4)[:, :3], atol=1e-12)
    # two tendons that strain alike and one beside them
    rows = [[1.0, 1.0, 0.0], [1.0, 1.0, 0.0], [0.0, 0.0, 2.0]]
    opposite = np.array(rows)
    mixing = independent_tensions(opposite, 1e-3)
    share = np.sqrt(0.5)
    sizes = np.abs(mixing)
    expected = [[share, 0], [share, 0], [0, 1]]
    np.testing.assert_allclose(sizes, expected)


def test_columns_of_actuation_are_what_strains_shorten_tendons_by():
    """-d|t_c| / d(k, p), by differences; t_c is the derivative of the path in the frame of the
    section, and a tendon that is not there has no column."""
    y = 0.01
    z = -0.004
    y_prime = 0.2
    z_prime = -0.3
    geometry = np.array([y, z, y_prime, z_prime, 1.0])
    strain = np.array([0.5, -2.0, 3.0, 1.1, 0.05, -0.02])

    def chord(xi):
        return chords(geometry, xi[:3], xi[3:])[1]

    in_section = np.array([0.0, y, z])
    turned = np.cross(strain[:3], in_section)
    expected = turned + strain[3:] + [0.0, y_prime, z_prime]
    np.testing.assert_allclose(chord(strain), expected, rtol=1e-14)
    h = 1e-6
    slopes = []
    for way in h * np.eye(6):
        longer = np.linalg.norm(chord(strain + way))
        shorter = np.linalg.norm(chord(strain - way))
        slope = (longer - shorter) / (2.0 * h)
        slopes.append(slope)
    column = actuation_columns(geometry, strain[:3], strain[3:])
    expected_column = np.negative(slopes)
    np.testing.assert_allclose(column, expected_column, atol=1e-8)
    absent = geometry * [1.0, 1.0, 1.0, 1.0, 0.0]
    assert not actuation_columns(absent, strain[:3], strain[3:]).any()


def test_gravity_pulls_at_rod_payload_and_discs_alone(build):
    """m g along the columns of the tip, by virtual work."""
    g = np.array([1.0, -4.0, -9.0])
    gravity = {"effects.gravity.acceleration": g.tolist(), "quadrature.intervals": 2}
    bare = build("three_tendon", gravity)
    loaded = build("three_tendon", {**gravity, "effects.tip_load.mass": 0.02})
    q = bare.rest_coordinates([1.0, 0.2, 0.5])
    still = np.zeros(3)
    terms = bare.terms(q, still)
    change = loaded.terms(q, still).external_force - terms.external_force
    in_tip = terms.tip_pose[:3, :3].T @ g
    expected = 0.02 * terms.tip_jacobian[3:].T @ in_tip
    np.testing.assert_allclose(change, expected, rtol=1e-9)
    rod = bare.arm.rod
    np.testing.assert_allclose(rod.node_mass.sum(), rod.mass)
    discs = {"mass": 0.003, "radius": 0.015, "places": [0.15, 0.3]}
    changes = {**gravity, "segments.0.discs": discs}
    spaced = build("three_tendon", changes)
    added = spaced.arm.rod.node_mass - rod.node_mass
    # there the intervals end, the last one and empty ones at the tip
    by_place = np.unique(np.round(added, 12))
    np.testing.assert_allclose(by_place, [0.0, 0.003])
    assert added.sum() == pytest.approx(0.006)


def test_paths_along_a_bent_rod_are_shorter_inside_and_turn_with_it():
    """L (1 - k y) of a tendon at y beside a rod with the curvature k about z, which turns by k per
    length of the rod from the first point to the last."""
    curvature = 5.0
    scene = load_scene("three_tendon")
    changes = {"segments.0.curvature": [0.0, 0.0, curvature]}
    bent = scene.replace(changes)
    grid = make_grid(bent, 5)
    rod = at_points(bent, grid).rod
    y = [tendon.routing.offset[0] for tendon in bent.tendons]
    expected = 0.3 * (1.0 - curvature * np.array(y))
    np.testing.assert_allclose(rod.tendon_length, expected, rtol=1e-12)
    points = grid.points[grid.real]
    turned = curvature * (points.max() - points.min())
    np.testing.assert_allclose(rod.tendon_turn, turned, rtol=1e-9)


def test_coordinates_are_present_where_their_tendons_are():
    """An independent tension on its tendon, a combination on all of its tendons."""
    scene, grid = grid_of("paper", 8)
    stress_free = at_points(scene, grid)
    strain = make_strain(scene, grid, stress_free)
    tendons = stress_free.tendons
    assert (tendons.pack_end < grid.packs).any()
    np.testing.assert_array_equal(strain.pack_begin, tendons.pack_begin)
    np.testing.assert_array_equal(strain.pack_end, tendons.pack_end)
    # two that strain alike up to 0.1 m, where both end
    twins = load_scene("three_tendon").replace(
        {
            "tendons.1.routing": load_scene("three_tendon").tendons[0].routing,
            "tendons.0.end": 0.1,
            "tendons.1.end": 0.1,
        }
    )
    grid = make_grid(twins, 8)
    mixed = make_strain(twins, grid, at_points(twins, grid))
    assert mixed.active == 2
    assert mixed.mixed
    assert sorted(mixed.pack_end.tolist()) == [grid.packs // 2, grid.packs]


def test_an_incompressible_rod_damps_by_three_times_its_viscosity_over_its_modulus():
    """Upsilon = eta diag(Jx, 3 Iy, 3 Iz, 3 A, k A, k A) beside E and G = E / 3: D = 3 eta / E G of
    the straight arm, 3 eta I L of one constant curvature."""
    viscosity = 300.0  # [Pa s]
    young = 5e5  # [Pa]
    modes = [{"strains": ["bend_z"], "order": 0, "span": "rod"}]
    scene = load_scene("three_tendon").replace({"segments.0.damping": viscosity})
    changes = {"strain": {"type": "explicit", "modes": modes}}
    explicit = scene.replace(changes)
    damping = model_on(explicit, 3).terms([0.0], [0.0]).damping
    second_moment = np.pi * 0.01**4 / 4
    expected_damping = 3.0 * viscosity * second_moment * 0.3
    assert damping.item() == pytest.approx(expected_damping)
    still = np.zeros(3)
    terms = model_on(scene, 3).terms(still, still)
    retardation = 3.0 * viscosity / young
    size = np.abs(terms.damping).max()
    np.testing.assert_allclose(
        terms.damping, retardation * terms.stiffness, rtol=1e-9, atol=1e-12 * size
    )


def test_a_border_is_on_the_side_of_the_piece_that_is_looked_at():
    """Whichever piece a density gives the border itself to."""
    _, grid = scene_and_grid("paper")

    def first_has_it(places):
        values = np.where(places <= 0.5, 1.0, 3.0)
        return values[:, None]

    def second_has_it(places):
        values = np.where(places < 0.5, 1.0, 3.0)
        return values[:, None]

    total = over_nodes(grid, first_has_it)
    same = over_nodes(grid, second_has_it)
    np.testing.assert_allclose(total, same, rtol=1e-12)
    share = 0.5 * newton_cotes(4)[0]
    expected_total = share * 1.0 + share * 3.0
    assert total[3, 0] == pytest.approx(expected_total)
