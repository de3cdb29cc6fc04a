"""Laws of contact against closed forms: distances, pressures, friction, virtual work, and where
steps end."""

import numpy as np
import pytest
from scipy.linalg import expm
from scipy.spatial.transform import Rotation

from soft_tendon_env.effects.contact import Contact
from soft_tendon_env.effects.contact.forces import (
    FREE,
    IDLE,
    LANDED,
    MOST_LANDED,
    OVERRUN,
    STICTION_SPEED,
    THROUGH,
    WALL,
    contact_wrench,
    goes_through,
    limit_contact,
    normal_law,
    read_contacts,
)
from soft_tendon_env.effects.contact.obstacles import body_at, distance, read_distances
from soft_tendon_env.effects.contact.outline import RECTANGLE, ROUND
from soft_tendon_env.effects.contact.samples import (
    SMOOTHING,
    WALL_MASS,
    WALL_SPEED,
    Sample,
    make_samples,
    sample_outlines,
)
from soft_tendon_env.mechanics.effects import (
    NO,
    TURN,
    YES,
    BeforeStep,
    Nodes,
    make_contact_flags,
)
from soft_tendon_env.mechanics.types import node_field

pytestmark = pytest.mark.no_jit

LENGTH = 0.3
RADIUS = 0.01
YOUNG = 5e5
DENSITY = 1070.0
PLACE = np.array([0.1, 0.2, 0.3])
AXIS = np.array([1.0, -2.0, 0.5]) / np.sqrt(5.25)
TURNED = {"position": PLACE.tolist(), "axis": [1.0, -2.0, 0.5]}
ROTATION = [20.0, -30.0, 40.0]
MU = 0.4
DISSIPATION = 0.7


def along_and_beside(x):
    """Distances of a point from PLACE along AXIS and beside it."""
    along = (x - PLACE) @ AXIS
    beside = x - PLACE - along * AXIS
    return along, np.linalg.norm(beside)


def to_box(half, q):
    """Signed distance of a box of half sizes from a point in its frame."""
    beyond = np.abs(q) - half
    outside = np.maximum(beyond, 0.0)
    return np.linalg.norm(outside) + min(beyond.max(), 0.0)


def to_plane(x):
    return along_and_beside(x)[0]


def to_sphere(x):
    return np.linalg.norm(x - PLACE) - 0.2


def to_capsule(x):
    along, beside = along_and_beside(x)
    beyond = max(abs(along) - 0.2, 0.0)
    return np.hypot(beyond, beside) - 0.1


def to_cylinder(x):
    along, beside = along_and_beside(x)
    half = np.array([0.1, 0.2])
    place = np.array([beside, along])
    return to_box(half, place)


def to_turned_box(x):
    frame = Rotation.from_rotvec(np.radians(ROTATION))
    half = np.array([0.1, 0.15, 0.2])
    in_frame = frame.inv().apply(x - PLACE)
    return to_box(half, in_frame)


SHAPES = [
    ({"type": "plane", **TURNED}, to_plane),
    ({"type": "sphere", "position": PLACE.tolist(), "radius": 0.2}, to_sphere),
    ({"type": "capsule", **TURNED, "radius": 0.1, "length": 0.4}, to_capsule),
    ({"type": "cylinder", **TURNED, "radius": 0.1, "length": 0.4}, to_cylinder),
    (
        {
            "type": "box",
            "position": PLACE.tolist(),
            "size": [0.2, 0.3, 0.4],
            "rotation": ROTATION,
        },
        to_turned_box,
    ),
]


@pytest.mark.parametrize(("obstacle", "expected"), SHAPES, ids=lambda case: str(case)[:16])
def test_distances_are_those_of_the_shapes(obstacle, expected):
    """Also of one that has moved, and from the nearest point of the surface, which is 0."""
    contact = Contact(obstacles=[{**obstacle, "velocity": [0.3, -0.2, 0.1]}])
    rng = np.random.default_rng(0)
    places = rng.uniform(-0.4, 0.4, (40, 3))
    x = PLACE + places
    out = np.empty((1, 40))
    nearest = np.empty((1, 40, 3))
    read_distances(contact.rows(), x, 0.0, out, nearest)
    exact = [expected(point) for point in x]
    np.testing.assert_allclose(out[0], exact, atol=1e-14)
    surface = nearest[0]
    np.testing.assert_allclose(contact.distances(surface)[0], 0.0, atol=1e-14)
    ways = np.linalg.norm(x - surface, axis=1)
    expected_ways = np.abs(exact)
    np.testing.assert_allclose(ways, expected_ways, atol=1e-14)
    # two seconds later
    direction = np.array([0.3, -0.2, 0.1])
    moved = x + 2.0 * direction
    later = contact.distances(moved, 2.0)
    np.testing.assert_allclose(later[0], exact, atol=1e-14)


THIN = {"type": "box", "position": [0.0, 0.0, 0.0], "size": [1.0, 1.0, 1e-3]}
THICK = {"type": "plane", "position": [0.0, 0.0, 0.0]}
K = 2000.0  # [N/m] of a sample
E = SMOOTHING * RADIUS


def body_of(obstacle, friction=MU, dissipation=DISSIPATION, time=0.0):
    contact = Contact(obstacles=[obstacle], friction=friction, dissipation=dissipation)
    return body_at(contact.rows(), 0, time)


def sample_of(wall=0.5):
    """A ball in the middle of an interval."""
    curve = (0.5, 0.0125, 0.5, -0.0125, 0.5)
    return Sample(*curve, RADIUS, K, E, wall, ROUND, RADIUS, RADIUS)


def law(body, depth, approach=0.0, wall=0.5):
    return normal_law(body, sample_of(wall), depth, approach)


def test_on_the_axis_of_a_cylinder_its_side_is_as_far_as_the_radius():
    """In one of all directions, which is a unit vector across the axis."""
    upright = {"type": "cylinder", "radius": 0.1, "length": 0.4, "axis": [0.0, 0.0, 1.0]}
    rows = Contact(obstacles=[{**upright, "position": [0.0, 0.0, 0.0]}]).rows()
    x = np.array([[0.0, 0.0, 0.0], [0.0, 0.0, 0.05]])
    out = np.empty((1, 2))
    nearest = np.empty((1, 2, 3))
    read_distances(rows, x, 0.0, out, nearest)
    np.testing.assert_allclose(out[0], -0.1, atol=1e-15)
    ways = nearest[0] - x
    np.testing.assert_allclose(np.linalg.norm(ways, axis=1), 0.1, atol=1e-15)
    np.testing.assert_allclose(ways[:, 2], 0.0, atol=1e-15)


@pytest.mark.parametrize("obstacle", [THIN, THICK], ids=["thin", "thick"])
@pytest.mark.parametrize("approach", [-5.0, -1.2, -0.5, 0.0, 0.8])
def test_pressure_has_its_derivatives_and_its_energy(obstacle, approach):
    """Before the smoothing depth, beyond it, and in the wall of what is thin or thick."""
    body = body_of(obstacle)
    h = 1e-8
    depths = (0.4 * E, 3.0 * E, 0.3 * RADIUS, 0.9 * RADIUS, 1.6 * RADIUS)
    for depth in depths:
        force, stiffness, damping, _ = law(body, depth, approach)
        assert force >= 0.0, "what leaves fast is not pulled back"
        deeper, _, _, more_energy = law(body, depth + h, approach)
        shallower, _, _, less_energy = law(body, depth - h, approach)
        by_depth = (deeper - shallower) / (2 * h)
        assert stiffness == pytest.approx(by_depth, rel=1e-6, abs=1e-6)
        faster, _, _, _ = law(body, depth, approach + h)
        slower, _, _, _ = law(body, depth, approach - h)
        by_approach = (faster - slower) / (2 * h)
        assert damping == pytest.approx(by_approach, rel=1e-6, abs=1e-5)
        # the energy is that of the force at no speed
        stored = (more_energy - less_energy) / (2 * h)
        at_rest, _, _, _ = law(body, depth)
        assert at_rest == pytest.approx(stored, rel=1e-6)


def test_pressure_is_hunt_and_crossleys_up_to_the_wall():
    """k d^2 / 2 e up to a depth e and k (d - e / 2) beyond, times 1 + c d_dot; nothing at 0."""
    for obstacle, thick in ((THIN, 5e-4), (THICK, RADIUS)):
        body = body_of(obstacle)
        begin = FREE * RADIUS + 0.5 * thick
        depths = (0.0, 0.5 * E, E, 10.0 * E, 0.999 * begin)
        for depth in depths:
            if depth < E:
                smooth = K * depth**2 / (2.0 * E)
            else:
                smooth = K * (depth - 0.5 * E)
            for approach in (0.0, 0.5, -0.5):
                expected = smooth * (1.0 + DISSIPATION * approach)
                assert law(body, depth, approach)[0] == pytest.approx(
                    expected, rel=1e-12, abs=1e-15
                )
        # the wall stores a quarter of its energy over its width, twice half of what is thick
        end = WALL * RADIUS + thick
        walled = law(body, end)[3]
        bare = law(body, end, wall=0.0)[3]
        assert walled - bare == pytest.approx(0.25 * 0.5)


def test_the_wall_lets_nothing_out_faster_than_its_dissipation():
    """Where the material dissipates less than 1 s/m, what leaves the wall at 1 m/s meets none."""
    elastic = body_of(THIN, dissipation=0.0)
    depth = 0.4 * RADIUS
    penalty = law(elastic, depth, wall=0.0)[0]
    assert law(elastic, depth, -0.5)[0] > 1.01 * penalty
    pressure = law(elastic, depth, -1.0)[0]
    assert pressure == pytest.approx(penalty)


@pytest.fixture(scope="module")
def rod(build):
    """Two intervals of 0.15 m, and two empty ones at the tip."""
    return build("three_tendon", {"quadrature.intervals": 2}).discretisation


@pytest.fixture(scope="module")
def arc(rod):
    """Poses (nodes, 4, 4) of an arm that bends and twists."""
    hat = np.array(
        [[0, -3.0, 1.0, 1.0], [3.0, 0, -2.0, 0.0], [-1.0, 2.0, 0, 0.0], [0, 0, 0, 0]], dtype=float
    )
    poses = [expm(place * hat) for place in rod.node]
    return np.array(poses)


def straight(rod, turn=0.0):
    """Poses (nodes, 4, 4) of a straight arm along x, turned about its axis."""
    repeats = (rod.node.size, 1, 1)
    poses = np.tile(np.eye(4), repeats)
    rotation = Rotation.from_rotvec([turn, 0.0, 0.0])
    poses[:, :3, :3] = rotation.as_matrix()
    poses[:, 0, 3] = rod.node
    return poses


def field_of(poses):
    rotations = poses[:, :3, :3].reshape(-1, 9)
    parts = [rotations, poses[:, :3, 3]]
    return node_field(np.concatenate(parts, axis=1))


def base_at(height):
    """A base (24) at rest that points along x, at a height [m]."""
    parts = [np.eye(3).ravel(), [0.0, 0.0, height], np.zeros(12)]
    return np.concatenate(parts)


def nodes_at(poses, twists=None, before=None, heights=(0.0, 0.0), mass=1.0):
    """Nodes at poses (nodes, 4, 4) with body twists (nodes, 6), by default at rest; before: poses
    before the step, a hundredth of a second ago; heights: of the base now and then."""
    count = len(poses)
    if twists is None:
        twists = np.zeros((count, 6))
    earlier = field_of(poses if before is None else before)
    base, base_before = map(base_at, heights)
    return Nodes(
        packs=count // 4,
        time=0.0,
        mass=np.full(count, mass),
        inertia=np.zeros(6 * count),
        pose=field_of(poses),
        twist=node_field(twists),
        base=base,
        wrench=np.zeros(6 * count),
        stiffness=np.zeros(21 * count),
        damping=np.zeros(21 * count),
        before_step=BeforeStep(np.array([-0.01]), earlier, base_before),
        contact=make_contact_flags(),
    )


def rows_of(field, components):
    """A field over nodes as (nodes, components)."""
    by_sample = field.reshape(-1, components, 4).swapaxes(1, 2)
    return by_sample.reshape(-1, components)


def read(parameters, nodes):
    """Gaps (samples,), positions and forces (samples, 3), for one obstacle, and the energy."""
    count = len(parameters.samples)
    gap = np.empty((1, count))
    position = np.empty((count, 3))
    force = np.empty((1, count, 3))
    energy = read_contacts(parameters, nodes, gap, position, force)
    return gap[0], position, force[0], energy


def moved(poses, twists, time):
    """Poses after a time of moving with body twists."""
    result = np.empty_like(poses)
    for i, (w, v) in enumerate(twists.reshape(-1, 2, 3)):
        hat = np.zeros((4, 4))
        hat[:3, :3] = np.cross(np.eye(3), w)
        hat[:3, 3] = v
        motion = expm(time * hat)
        result[i] = poses[i] @ motion
    return result


def surface_velocities(parameters, poses, twists, normal):
    """Velocities (samples, 3) of the points of the samples' surfaces that touch a plane, by
    differences of their middles and the angular velocities between the nodes."""
    # velocities of the middles
    h = 1e-6
    nodes = nodes_at(moved(poses, twists, h))
    _, after, _, _ = read(parameters, nodes)
    nodes_before = nodes_at(moved(poses, twists, -h))
    _, before, _, _ = read(parameters, nodes_before)
    velocity = (after - before) / (2 * h)
    # angular velocities of base and nodes, in the world frame, and between them
    rotation = poses[:, :3, :3]
    of_nodes = np.einsum("nij,nj->ni", rotation, twists[:, :3])
    turning = np.vstack([np.zeros(3), of_nodes])
    numbers = parameters.intervals[:2, 1:3]
    first, last = numbers.astype(int).T
    behind = np.repeat([1, 2], last - first)
    t = parameters.samples[:, 4:5]
    w = t * turning[behind] + (1.0 - t) * turning[behind - 1]
    radius = parameters.samples[:, 5:6]
    return velocity + np.cross(w, -radius * normal)


@pytest.fixture(params=[0.0, 0.3], ids=["still", "belt"])
def sliding(request, rod, arc):
    """An arm that slides on and off an inclined plane, which may move: its contact, nodes, normal,
    and velocities of the surfaces relative to the plane."""
    direction = np.array([0.2, -0.3, 1.0])
    normal = direction / np.sqrt(1.13)
    belt = request.param * np.array([1.0, 0.5, 0.2])
    plane = {"type": "plane", "position": [0.0, 0.0, -0.005], "axis": normal.tolist()}
    contact = Contact(
        obstacles=[{**plane, "velocity": belt.tolist()}], friction=MU, dissipation=DISSIPATION
    )
    parameters = contact.parameters(rod)
    rng = np.random.default_rng(0)
    draws = rng.normal(size=(rod.node.size, 6))
    sizes = np.repeat([2.0, 0.1], 3)
    twists = draws * sizes
    velocity = surface_velocities(parameters, arc, twists, normal)
    return parameters, nodes_at(arc, twists), normal, velocity, belt


def test_forces_are_pressure_along_the_normal_and_friction_against_slip(sliding):
    parameters, nodes, normal, velocity, belt = sliding
    gap, position, force, _ = read(parameters, nodes)
    radius, stiffness, smoothing = parameters.samples[:, 5:8].T
    height = (position + [0.0, 0.0, 0.005]) @ normal
    np.testing.assert_allclose(gap, height - radius, atol=1e-15)
    relative = velocity - belt
    approach = -relative @ normal
    slip = relative + approach[:, None] * normal
    depth = np.clip(-gap, 0.0, FREE * radius)  # the others are in the wall
    penalty = np.where(
        depth < smoothing,
        stiffness * depth**2 / (2.0 * smoothing),
        stiffness * (depth - 0.5 * smoothing),
    )
    factor = 1.0 + DISSIPATION * approach
    pressure = penalty * np.maximum(factor, 0.0)
    squares = (slip**2).sum(axis=1) + STICTION_SPEED**2
    speed = np.sqrt(squares)
    friction = MU * slip / speed[:, None]
    expected = pressure[:, None] * (normal - friction)
    is_soft = -gap < FREE * radius
    assert (is_soft & (gap < 0.0)).sum() > 3
    np.testing.assert_allclose(force[is_soft], expected[is_soft], rtol=1e-5, atol=1e-9)
    assert (gap > 0.0).any()
    assert not force[gap > 0.0].any()


def test_wrenches_at_the_nodes_have_the_power_of_the_forces_on_the_surfaces(sliding):
    parameters, nodes, _, velocity, _ = sliding
    contact_wrench(parameters, nodes)
    _, _, force, _ = read(parameters, nodes)
    wrenches = rows_of(nodes.wrench, 6)
    node_twists = rows_of(nodes.twist, 6)
    power = (wrenches * node_twists).sum()
    expected_power = (force * velocity).sum()
    assert power == pytest.approx(expected_power, rel=1e-6)
    assert nodes.contact.touched[0] == YES


def test_sliding_down_an_incline_is_as_fast_as_coulombs_law_has_it(rod):
    """g (sin - mu cos) of a ball that is pressed on by its weight, and 0 across."""
    angle = np.radians(35.0)
    gravity = 9.81
    mass = 0.02
    sine = np.sin(angle)
    cosine = np.cos(angle)
    down = np.array([cosine, 0.0, -sine])
    normal = np.array([sine, 0.0, cosine])
    weight = mass * gravity * cosine
    depth = weight / K + 0.5 * E
    body = body_of({"type": "plane", "position": [0.0, 0.0, 0.0], "axis": normal.tolist()})
    contact = Contact(
        obstacles=[{"type": "plane", "position": [0.0, 0.0, 0.0], "axis": normal.tolist()}],
        friction=MU,
        dissipation=DISSIPATION,
    )
    pressure, _, _, _ = normal_law(body, sample_of(), depth, 0.0)
    assert pressure == pytest.approx(weight)
    # the tip's ball touches, of an arm that lies along the incline: the others are left out
    parameters = contact.parameters(rod)
    parameters.samples[-1, 6:8] = K, E
    poses = straight(rod)
    aside = np.cross(normal, down)
    poses[:, :3, :3] = np.stack([down, aside, normal], axis=1)
    along = rod.node[:, None] * down
    above = (RADIUS - depth) * normal
    poses[:, :3, 3] = along + above
    twists = np.zeros((rod.node.size, 6))
    rotation = poses[0, :3, :3]
    twists[:, 3:] = rotation.T @ (5.0 * down)
    nodes = nodes_at(poses, twists)
    _, _, force, _ = read(parameters, nodes)
    specific_force = force[-1] / mass
    acceleration = specific_force - [0.0, 0.0, gravity]
    share = sine - MU * cosine
    assert acceleration @ down == pytest.approx(gravity * share)
    assert acceleration @ normal == pytest.approx(0.0, abs=1e-9)


def test_a_ball_that_rolls_does_not_rub(rod):
    poses = straight(rod)
    contact = Contact(
        obstacles=[{"type": "plane", "position": [0.0, 0.0, -0.999 * RADIUS]}], friction=MU
    )
    parameters = contact.parameters(rod)
    twist = [2.0, 0.0, 0.0, 0.0, -2.0 * RADIUS, 0.0]
    rolling = np.tile(twist, (rod.node.size, 1))
    second = slice(int(parameters.intervals[1, 1]), None)  # the base of the first one stands still
    rolling_nodes = nodes_at(poses, rolling)
    _, _, force, _ = read(parameters, rolling_nodes)
    assert (force[second, 2] > 0.0).all()
    np.testing.assert_allclose(force[second, :2], 0.0, atol=1e-12)
    signs = [1, 1, 1, 1, -1, 1]
    _, _, sliding_force, _ = read(parameters, nodes_at(poses, -rolling * signs))
    bound = 0.3 * MU * force[second, 2]
    assert (sliding_force[second, 1] > bound).all()


@pytest.fixture
def edge(rod):
    """A flat box that one sample of the second interval alone touches, its row, and the poses."""
    intervals, samples, places = make_samples(rod)
    row = int(intervals[1, 1]) + 6
    depth = 3.0 * E
    box = {
        "type": "box",
        "size": [0.004, 0.1, 0.02],
        "position": [places[row], 0.0, -(RADIUS + 0.01 - depth)],
    }
    return box, samples[row], straight(rod, 0.7)


def blocks_of(field):
    """Symmetric blocks (nodes, 6, 6) of their lower triangles."""
    lower = rows_of(field, 21)
    blocks = np.zeros((len(lower), 6, 6))
    rows, columns = np.tril_indices(6)
    blocks[:, rows, columns] = lower
    blocks[:, columns, rows] = lower
    return blocks


@pytest.mark.parametrize("friction", [0.0, MU])
def test_blocks_of_the_nodes_are_derivatives_of_their_wrenches(rod, edge, friction):
    """By the motion of a node alone, times the part of the sample that the node has; parts add up
    to 1."""
    box, sample, poses = edge
    contact = Contact(obstacles=[box], friction=friction, dissipation=DISSIPATION)
    parameters = contact.parameters(rod)
    nodes = nodes_at(poses)
    contact_wrench(parameters, nodes)
    stiffness = blocks_of(nodes.stiffness)
    damping = blocks_of(nodes.damping)
    t = sample[4]
    h = 1e-9
    for node, part in ((1, t), (0, 1.0 - t)):

        def wrench(displacement=0.0, twist=0.0, node=node):
            moving = poses.copy()
            twists = np.zeros((rod.node.size, 6))
            rotation = poses[node, :3, :3]
            way = displacement * np.ones(3)
            moving[node, :3, 3] += rotation @ way
            twists[node] = twist
            pushed = nodes_at(moving, twists)
            contact_wrench(parameters, pushed)
            return rows_of(pushed.wrench, 6)[node]

        for k, unit in enumerate(np.eye(6)):
            ahead = wrench(twist=h * unit)
            behind = wrench(twist=-h * unit)
            slope = -(ahead - behind) / (2 * h)
            expected = part * damping[node][:, k]
            greatest = np.abs(damping).max()
            np.testing.assert_allclose(slope, expected, atol=1e-4 * greatest)
            if k >= 3:
                step = h * unit[3:]
                change = wrench(step) - wrench(-step)
                slope = -change / (2 * h)
                expected = part * stiffness[node][:, k]
                greatest_stiffness = np.abs(stiffness).max()
                np.testing.assert_allclose(slope, expected, atol=1e-4 * greatest_stiffness)
    assert np.abs(stiffness).max() > 0.0
    assert not stiffness[2:].any()


def test_samples_stand_for_the_rod_and_interpolate_it(rod):
    intervals, samples, places = make_samples(rod)
    lengths, first, last, largest = intervals.T
    expected_lengths = np.diff(rod.node, prepend=0.0)
    np.testing.assert_allclose(lengths, expected_lengths)
    assert first[0] == 0
    assert last[-1] == len(samples)
    np.testing.assert_array_equal(first[1:], last[:-1])
    np.testing.assert_allclose(largest[:2], RADIUS)
    largest_step = np.diff(places, prepend=0.0).max()
    assert largest_step <= RADIUS * (1 + 1e-12)
    assert places[-1] == pytest.approx(LENGTH)
    # stiffness E A / (2 r)^2 and mass of a share of the length, the last one's with the round cap
    share = np.full(len(samples), places[0])
    share[-1] = 0.5 * places[0] + RADIUS
    area = np.pi * RADIUS**2
    stiffness = YOUNG * area / (2 * RADIUS) ** 2
    np.testing.assert_allclose(samples[:, 6], stiffness * share)
    np.testing.assert_allclose(samples[:, 7], SMOOTHING * RADIUS)
    wall_energy = WALL_MASS * WALL_SPEED**2
    energy = wall_energy * DENSITY * area * share
    np.testing.assert_allclose(samples[:, 8], energy)
    # the Hermite polynomials give back any cubic
    columns = samples[:, :5]
    h_a, reach_a, h_b, reach_b, t = columns.T
    counts = (last - first)[:2].astype(int)
    end = np.repeat(rod.node[:2], counts)
    start = end - 0.15
    cubic = np.poly1d([2.0, -1.0, 3.0, 0.5])
    slope = np.polyder(cubic)
    of_height = h_a * cubic(start)
    of_reach = reach_a * slope(start)
    of_start = of_height + of_reach
    of_height_b = h_b * cubic(end)
    of_reach_b = reach_b * slope(end)
    of_end = of_height_b + of_reach_b
    np.testing.assert_allclose(of_start + of_end, cubic(places), rtol=1e-12)
    np.testing.assert_allclose(start + t * 0.15, places)


def test_samples_next_to_discs_are_as_large_and_as_heavy(build):
    discs = {"segments.0.discs": {"mass": 1e-3, "radius": 0.02, "thickness": 0.002, "number": 2}}
    plain, with_discs = (
        make_samples(build("three_tendon", {"quadrature.intervals": 2, **changes}).discretisation)
        for changes in ({}, discs)
    )
    places = plain[2]
    change = with_discs[1] - plain[1]
    rows = np.flatnonzero(change[:, 5])
    np.testing.assert_allclose(places[rows], [0.15, 0.3])
    np.testing.assert_allclose(change[rows, 5], 0.01)
    # the cap of the disc at the tip is larger too
    line_mass = DENSITY * np.pi * RADIUS**2
    heavier = 1e-3 + line_mass * np.array([0.0, 0.01])
    wall_energy = WALL_MASS * WALL_SPEED**2
    np.testing.assert_allclose(change[rows, 8], wall_energy * heavier)
    assert np.count_nonzero(change[:, 8]) == 2


def test_discs_on_a_flat_rod_are_round(build):
    """Where the nearest sample is; the others have the corners of the rod."""
    flat = {
        "segments.0.radius": None,
        "segments.0.section": {"type": "rectangle", "width": 0.004, "height": 0.02},
        "segments.0.discs": {"mass": 1e-3, "radius": 0.02, "thickness": 0.002, "number": 2},
    }
    rod = build("three_tendon", {"quadrature.intervals": 2, **flat}).discretisation
    places = np.array([0.1, 0.15, 0.2, 0.3])
    outlines = sample_outlines(rod, places)
    np.testing.assert_array_equal(outlines.shape, [RECTANGLE, ROUND, RECTANGLE, ROUND])
    np.testing.assert_allclose(outlines.radius, [0.002, 0.02, 0.002, 0.02])
    around = np.hypot(0.002, 0.01)
    np.testing.assert_allclose(outlines.largest, [around, 0.02, around, 0.02])
    np.testing.assert_allclose(outlines.half_widths[0], 0.002)
    np.testing.assert_allclose(outlines.half_widths[1], 0.01)


def floor(height, **motion):
    return {"type": "plane", "position": [0.0, 0.0, height], **motion}


def longest_step(contact, rod, nodes, longest=1.0):
    step = np.array([longest])
    limit_contact(contact.parameters(rod), nodes, step)
    return float(step[0]), nodes.contact


def landing_depths(contact, rod, energy):
    """Depths (samples,) at which an energy k d^3 / 6 e is stored, the smoothing depth at most."""
    _, samples, _ = make_samples(rod)
    stiffness, smoothing = samples[:, 6:8].T
    cubed = 6.0 * smoothing * energy / stiffness
    return np.minimum(smoothing, cubed ** (1.0 / 3.0))


@pytest.mark.parametrize("mass", [1e-12, 1e-2])
@pytest.mark.parametrize("speed", [0.0, 0.4, -0.4])
@pytest.mark.parametrize("rising", [0.0, 0.3])
def test_the_next_step_ends_where_the_arm_lands(rod, mass, speed, rising):
    """All nodes fall at a speed on a floor that rises: at the first sample that then stores its
    share of the arm's energy."""
    gap = 1e-3
    obstacle = floor(-RADIUS - gap, velocity=[0.0, 0.0, rising])
    contact = Contact(obstacles=[obstacle])
    twists = np.zeros((rod.node.size, 6))
    twists[:, 5] = -speed
    nodes = nodes_at(straight(rod), twists, mass=mass)
    step, flags = longest_step(contact, rod, nodes)
    total = mass * rod.node.size
    counted = max(IDLE * LENGTH, rising)
    square_speeds = speed**2 + counted**2
    energy = LANDED * 0.5 * total * square_speeds
    intervals, samples, _ = make_samples(rod)
    share = samples[:, 0] + samples[:, 2]
    first_end = int(intervals[0, 2])
    share[:first_end] = samples[:first_end, 2]  # the base stands still
    approach = speed * share + rising
    room = gap + landing_depths(contact, rod, energy)
    speeds = np.maximum(approach, 1e-9)
    time = room / speeds
    expected = min(1.0, time.min())
    assert step == pytest.approx(expected, rel=1e-9)
    assert flags.active[0] == (YES if expected < 1.0 else NO)
    assert flags.tunnelled[0] == NO
    obstacle = floor(-5.0, velocity=[0.0, 0.0, rising])
    far = Contact(obstacles=[obstacle])
    assert longest_step(far, rod, nodes_at(straight(rod), twists))[0] == 1.0


def test_a_step_in_contact_goes_deeper_by_a_share_of_the_radius_at_most(rod):
    contact = Contact(obstacles=[floor(-0.99 * RADIUS)])
    twists = np.zeros((rod.node.size, 6))
    twists[:, 5] = -0.4
    nodes_of_rod = nodes_at(straight(rod), twists)
    step, flags = longest_step(contact, rod, nodes_of_rod)
    expected_step = OVERRUN * RADIUS / 0.4
    assert step == pytest.approx(expected_step)
    assert flags.active[0] == YES


def test_what_nodes_that_turn_bring_along_is_met_too(rod):
    """The middle between two nodes that stand still comes down by h / 8 of the sum of their
    rates."""
    height = 0.3
    rate = 20.0
    twists = np.zeros((rod.node.size, 6))
    twists[0, 1] = rate
    twists[1:, 1] = -rate
    contact = Contact(obstacles=[floor(-height)])
    straight_nodes = nodes_at(straight(rod), twists)
    step, flags = longest_step(contact, rod, straight_nodes)
    speed = 2.0 * rate * 0.15 / 8.0
    time = (height - RADIUS) / speed
    assert step == pytest.approx(time, rel=0.02)
    assert flags.active[0] == YES


def test_steps_are_short_beside_the_swing_of_an_obstacle(rod):
    poses = straight(rod)
    swinging = Contact(obstacles=[floor(-1.0, amplitude=[0.0, 0.1, 0.0], frequency=30.0)])
    step, _ = longest_step(swinging, rod, nodes_at(poses))
    expected_step = TURN / (2.0 * np.pi * 30.0)
    assert step == pytest.approx(expected_step)
    still = Contact(obstacles=[floor(-1.0, frequency=30.0)])
    longest, _ = longest_step(still, rod, nodes_at(poses))
    assert longest == 1.0


def lifted(rod, height):
    """Poses of a straight arm at a height [m]."""
    poses = straight(rod)
    poses[:, 2, 3] = height
    return poses


@pytest.mark.parametrize(
    ("before", "now", "is_too_deep"),
    [
        (2.0, 1.5, False),
        (2.0, 1.0 - 0.9 * THROUGH, False),
        (2.0, 1.0 - 1.1 * THROUGH, True),
        (0.9, 0.9 - 0.9 * THROUGH, False),
        (0.9, 0.9 - 1.1 * THROUGH, True),
        (1.5, -2.0, True),
        (50.0, -50.0, True),
    ],
)
def test_a_step_that_leads_through_something_is_told(rod, before, now, is_too_deep):
    """Heights of an arm over a thin plate, in radii: deeper by THROUGH of them at once is too
    deep."""
    plate = {"type": "box", "size": [1.0, 1.0, 1e-3], "position": [0.0, 0.0, -5e-4]}
    heights = (now * RADIUS, before * RADIUS)
    nodes = nodes_at(
        lifted(rod, heights[0]), before=lifted(rod, heights[1]), heights=heights, mass=1e6
    )
    _, flags = longest_step(Contact(obstacles=[plate]), rod, nodes)
    assert (flags.tunnelled[0] == YES) == is_too_deep


@pytest.mark.parametrize(("share", "refused"), [(0.9, False), (1.2, True)])
def test_a_landing_that_stores_too_much_of_the_energy_is_told(rod, share, refused):
    depth = 2.0 * E
    contact = Contact(obstacles=[floor(-RADIUS)])
    twists = np.zeros((rod.node.size, 6))
    twists[:, 5] = -1.0
    # stored by the samples of the second interval, and by those of the first which came down less
    before = lifted(rod, 1e-3)
    now = lifted(rod, -depth)
    _, _, _, stored = read(contact.parameters(rod), nodes_at(now))
    speed = np.hypot(1.0, IDLE * LENGTH)
    mass = stored / (share * MOST_LANDED * LANDED * 0.5 * speed**2 * rod.node.size)
    nodes = nodes_at(now, twists, before=before, mass=mass)
    _, flags = longest_step(contact, rod, nodes)
    assert (flags.tunnelled[0] == YES) == refused


@pytest.mark.parametrize(
    "obstacle", [shape for shape, _ in SHAPES], ids=lambda shape: shape["type"]
)
def test_ways_through_an_obstacle_are_found(obstacle):
    """Against a thousand places along random ways; what passes at some distance is let through."""
    body = body_of(obstacle)
    rng = np.random.default_rng(1)
    shares = np.linspace(0.0, 1.0, 1000)[:, None]
    outcomes = set()
    for start, end in rng.uniform(-0.6, 0.6, (60, 2, 3)):
        way = start + shares * (end - start)
        nearest = min(distance(body, tuple(point))[0] for point in way[::5])
        allowed = 0.01
        through = goes_through(body, tuple(start), tuple(end), allowed)
        if nearest < allowed:
            assert through
        if nearest > allowed + 0.05:
            assert not through
        outcomes.add(through)
    assert outcomes == {True, False}
