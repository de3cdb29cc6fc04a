"""Designs at the edge: redundant, few and many tendons, extreme stiffness ratios and shapes,
damping, masses, buckling.

Each breaks an assumption that holds for the paper's arm: as many coordinates as tendons, similar
compliances in all directions (units), a well-conditioned mass matrix, damping of a tenth, one
density, no load.
"""

import numpy as np
import pytest

import soft_tendon_env as ste
from soft_tendon_env.mechanics.workspace import make_workspace
from soft_tendon_env.model.equilibrium_residual import Balance
from soft_tendon_env.model.statics import static_equilibrium
from soft_tendon_env.scene.routing import HelixRouting, StraightRouting
from soft_tendon_env.scene.scene import Scene, Segment, Tendon


def test_four_tendons_make_three_coordinates(build, measured):
    """The commonest design: opposite pairs pull alike on the straight arm, so that M, D and G of
    four tension coordinates are singular. Expected: three coordinates; a pull on each of the four
    bends by the same amount to its side; pulling all four leaves the arm straight.
    """
    model = build("four_tendon")
    assert model.coordinate_count == 3
    terms = model.terms(np.zeros(3), np.zeros(3))
    assert np.linalg.cond(terms.stiffness) < 1e3
    for value in (1.0, 5.0, 10.0):
        tips = [static_equilibrium(model, value * np.eye(4)[i]).tip_pose[:3, 3] for i in range(4)]
        motions = [
            ste.simulate(model, value * np.eye(4)[i], 1.0, 0.05).tip_pose[:, :3, 3]
            for i in range(4)
        ]
        for found in (tips, motions):
            sides = enumerate([(1, 0), (0, 1), (-1, 0), (0, -1)])
            for i, (y, z) in sides:
                turned = np.stack(
                    [found[0][..., 0], y * found[0][..., 1], z * found[0][..., 1]], axis=-1
                )
                misfit = np.abs(found[i] - turned).max()
                measured("asymmetry [m]", misfit)
                assert misfit < 1e-9
        together = ste.simulate(model, np.full(4, value), 1.0, 0.05)
        across = together.tip_pose[:, 1:3, 3]
        assert np.abs(across).max() < 1e-9
        assert together.tip_pose[-1, 0, 3] < 0.25


def test_four_tendons_against_an_explicit_basis(build, measured, tip_distance):
    """Three coordinates for four tensions: what the fourth adds must not be lost away from the
    straight shape. Expected: equilibria within 1e-9 m of the same arm with cubic strains (24
    coordinates)."""
    model = build("four_tendon")
    modes = {
        "strains": ["torsion", "bend_y", "bend_z", "stretch", "shear_y", "shear_z"],
        "order": 3,
        "span": "rod",
    }
    changes = {"strain": {"type": "explicit", "modes": [modes]}}
    full = build("four_tendon", changes)
    tensions = ([3, 3, 3, 3], [10, 0, 0, 0], [10, 3, 2, 7], [10, 10, 0, 0])
    for tension in tensions:
        few = static_equilibrium(model, tension)
        many = static_equilibrium(full, tension)
        assert few.converged
        assert many.converged
        measured("tip distance [mm]", 1e3 * tip_distance(few.tip_pose, many.tip_pose))
        assert tip_distance(few.tip_pose, many.tip_pose) < 1e-9


def test_one_tendon(one_segment, straight_tendons, measured, tip_distance):
    """One tendon, one coordinate: vectors of one element, matrices of one by one, packs nearly
    empty. Expected: statics and the end of the motion agree; the arm stays in its plane."""
    model = one_segment(tendons=straight_tendons((0.016, 0.0)), damping=1e5)
    assert model.coordinate_count == 1
    rest = static_equilibrium(model, [20.0])
    motion = ste.simulate(model, [20.0], 80.0, 0.1)
    measured("motion to statics [m]", tip_distance(motion.tip_pose[-1], rest.tip_pose))
    assert rest.converged
    assert tip_distance(motion.tip_pose[-1], rest.tip_pose) < 1e-5
    sideways = motion.tip_pose[:, 2, 3]
    assert np.abs(sideways).max() < 1e-12


@pytest.mark.parametrize("value", [pytest.param(1.0, marks=pytest.mark.slow), 5.0])
def test_thirty_tendons(one_segment, measured, value):
    """Thirty tendons, straight ones and spirals with ten different ends: 11 pieces of rod, more
    tendons than strains, dependent columns. Expected: no more coordinates than tendons, statics
    converge, the motion is finite, and the coordinates stay below 3 times the norm of the
    tensions."""
    rng = np.random.default_rng(0)
    tendons = []
    for i in range(30):
        end = None
        if i % 3 == 0:
            end = float(rng.uniform(0.3, 1.0))
        y = float(0.015 * np.cos(i))
        z = float(0.015 * np.sin(i))
        straight = StraightRouting(offset=(y, z))
        spiral = HelixRouting(
            radius=0.015, angular_rate=float(rng.uniform(-12, 12)), phase=40.0 * i
        )
        tendon = Tendon(routing=straight if i % 2 else spiral, end=end)
        tendons.append(tendon)
    model = one_segment(tendons=tendons)
    u = value * rng.uniform(size=30)
    rest = static_equilibrium(model, u)
    motion = ste.simulate(model, u, 2.0, 0.01)
    measured("coordinates", model.coordinate_count)
    largest = np.abs(motion.q).max()
    measured("q / norm of tensions", largest / np.linalg.norm(u))
    assert 12 < model.coordinate_count < 30
    assert rest.converged
    assert rest.residual < 1e-9
    assert np.isfinite(motion.tip_pose).all()
    largest_q = np.abs(motion.q).max()
    bound = 3 * np.linalg.norm(u)
    assert largest_q < bound


def test_no_tendon(build, measured):
    """Without tendons there is nothing to step with and no coordinate. Expected: ConfigurationError
    that says how many there should be, from the constructor, from `replace` and from a table."""
    scene = build("three_tendon").scene
    for attempt in (
        lambda: scene.replace({"tendons": []}),
        lambda: Scene(name="bare", segments=scene.segments, tendons=()),
        lambda: Scene.parse(
            {"name": "bare", "segments": list(scene.segments), "tendons": []}, "bare.toml"
        ),
    ):
        with pytest.raises(ste.ConfigurationError, match="tendons is .*at least 1 item"):
            attempt()


@pytest.mark.parametrize("step", [0.001, 0.01])
@pytest.mark.parametrize("tension", [0.01, 0.1, 1.0, 20.0])
def test_catheter(build, measured, one_pulled, tip_distance, tension, step):
    """A nitinol wire: stretching is 1e5 times stiffer than bending, and its axial waves take
    microseconds. Expected: at small loads the constant-curvature arc, at all loads the static
    equilibrium as the end of the motion at 1 and 10 ms."""
    model = build("catheter", {"integrator.step": step})
    u = one_pulled(model, 0, tension)
    rest = static_equilibrium(model, u)
    bending = 60e9 * np.pi * 0.0005**4 / 4
    k = tension * 0.002 / bending
    x = np.sin(0.2 * k) / k
    y = (1 - np.cos(0.2 * k)) / k
    arc = np.array([x, y, 0.0])
    measured(
        "statics to the arc, part of the length", np.abs(rest.tip_pose[:3, 3] - arc).max() / 0.2
    )
    assert rest.converged
    position = rest.tip_pose[:3, 3]
    bound = 0.2 * (1e-5 + 4e-4 * 0.2 * k)
    difference = position - arc
    assert np.abs(difference).max() < bound
    motion = ste.simulate(model, u, 4.0, 0.01)
    assert np.abs(motion.q).max() < 1.5 * tension
    assert tip_distance(motion.tip_pose[-1], rest.tip_pose) < 1e-6


@pytest.mark.parametrize("angle", [0.01, 1.0, 3.0])
@pytest.mark.parametrize("shape", ["slender", "stubby"])
def test_slender_and_stubby_arms(one_segment, measured, tip_distance, shape, angle):
    """Length over radius 2000 (bending 1e6 times softer than stretching) and 5 (shear and stretch
    as large as bending). Expected: the slender arm is an arc of constant curvature; the stubby one,
    which is shortened by its tendon, lies within 20 % of it and closer to its start; both stay
    finite and bounded in motion."""
    length, radius, young, damping = (
        (1.0, 0.0005, 1e9, 1e7) if shape == "slender" else (0.1, 0.02, 1e6, 1e3)
    )
    model = one_segment(length=length, radius=radius, young_modulus=young, damping=damping)
    moment = angle * young * np.pi * radius**4 / 4
    u = np.array([moment / (0.8 * radius * length), 0.0, 0.0])
    k = angle / length
    x = np.sin(angle) / k
    y = (1 - np.cos(angle)) / k
    arc = np.array([x, y, 0.0])
    rest = static_equilibrium(model, u)
    way = rest.tip_pose[:3, 3] - arc
    misfit = np.linalg.norm(way) / length
    measured("statics to the arc, part of the length", misfit)
    assert rest.converged
    assert misfit < (1e-3 if shape == "slender" else 0.2)
    motion = ste.simulate(model, u, 20.0, 0.05)
    largest = np.abs(motion.q).max()
    assert largest < 2 * u[0]
    if shape == "stubby":
        distance = np.linalg.norm(rest.tip_pose[:3, 3])
        distance_of_arc = np.linalg.norm(arc)
        assert distance < distance_of_arc
        assert tip_distance(motion.tip_pose[-1], rest.tip_pose) < 1e-6


@pytest.mark.parametrize(
    "step", [*(pytest.param(step, marks=pytest.mark.slow) for step in (0.005, 0.01)), 0.05]
)
def test_a_hundred_times_the_damping(build, measured, step):
    """Damping of 10 times critical: rates from 1e-1 to 1e6 1/s in one equation. Expected: no
    overshoot, no rejected step, and the tensions are reached after 200 s."""
    changes = {"segments.0.damping": 1e6, "integrator.step": step}
    model = build("paper", changes)
    u = np.zeros(10)
    u[[0, 4]] = 50.0, 30.0
    motion = ste.simulate(model, u, 200.0, 1.0)
    measured("overshoot [N]", np.abs(motion.q).max() - 50.0)
    assert np.abs(motion.q).max() < 50.0 + 1e-6
    assert motion.rejected == 0
    change = motion.q[-1] - u
    assert np.abs(change).max() < 1e-6


@pytest.mark.filterwarnings("ignore:.*coordinates are too many")
@pytest.mark.parametrize("gap", [1e-3, 1e-4])
@pytest.mark.parametrize("step", [pytest.param(0.0005, marks=pytest.mark.slow), 0.01])
def test_tendons_that_end_a_millimetre_apart(one_segment, straight_tendons, measured, gap, step):
    """Two equal tendons, one of which ends 1 mm (0.1 mm) before the other: a piece of 1 mm, and
    columns equal but for it. Expected: statics converge with q = u; under abrupt 50 N and random
    0-50 N every 10 ms no coordinate exceeds twice the tension."""
    tendons = straight_tendons(
        (0.016, 0), (0.016, 0, 1.0 - gap), (-0.008, 0.0138), (-0.008, -0.0138)
    )
    model = one_segment(tendons=tendons, changes={"integrator.step": step})
    for u in ([50.0, 0, 0, 0], [0, 50.0, 0, 0], [50.0, 50.0, 50.0, 50.0]):
        rest = static_equilibrium(model, u)
        assert rest.converged
        difference = rest.q - u
        assert np.abs(difference).max() < 1e-6
        motion = ste.simulate(model, u, 2.0, 0.01)
        measured("q / tension", np.abs(motion.q).max() / 50.0)
        assert np.abs(motion.q).max() < 100.0
    rng = np.random.default_rng(1)
    tensions = rng.uniform(0, 50, (1000, 4))
    motion = ste.simulate(model, tensions, 10.0, 0.01)
    measured("q / tension, random", np.abs(motion.q).max() / 50.0)
    assert np.abs(motion.q).max() < 100.0


@pytest.mark.slow
@pytest.mark.parametrize("place", ["base", "middle", "tip"])
def test_ends_of_tendons_within_round_off(
    one_segment, straight_tendons, measured, tip_distance, place
):
    """Ends of tendons, computed in different ways, lie within a few billionths of the length; a
    tendon may lie between two of them. Expected: every one of 100 random arms can be built, and
    their statics do not feel it."""
    rng = np.random.default_rng(2)
    off = []
    first, up, down = (
        {"base": 0.0, "middle": 0.5, "tip": 1.0 - 10e-9}[place],
        *(StraightRouting(offset=(0.0, y)) for y in (0.016, -0.016)),
    )
    for _ in range(100):
        ends = first + 1e-9 * rng.uniform(0.0, 5.0, 8)
        tendons = [
            *straight_tendons((0.016, 0), (-0.008, 0.0138), (-0.008, -0.0138)),
            *(Tendon(routing=up, end=float(end)) for end in ends[:4] if end > 4e-9),
            *(Tendon(routing=up, start=float(start)) for start in ends[4:7]),
            Tendon(routing=down, start=float(ends[7]), end=float(ends[7] + 4.1e-9)),
        ]
        model = one_segment(tendons=tendons)
        tension = np.where(np.arange(model.tendon_count) < 3, 5.0, 0.0)
        rest = static_equilibrium(model, tension)
        assert rest.converged, rest.reason
        off.append(rest.tip_pose[:3, 3])
    spread = np.ptp(off, axis=0).max()
    measured("spread of tips, part of the length", spread)
    assert spread < 1e-7


@pytest.mark.parametrize("densities", [(100.0, 1e4), (1e4, 100.0)])
@pytest.mark.parametrize("step", [0.001, 0.01])
def test_density_ratio_of_a_hundred(straight_tendons, measured, tip_distance, densities, step):
    """A segment a hundred times heavier than the other: light on heavy is stiff, heavy on light
    whips. Expected: no coordinate exceeds twice the tension, and 10 ms agree with 1 ms in their
    first second to 2 % of the length."""
    tendons = straight_tendons(
        *((0.016 * np.cos(a), 0.016 * np.sin(a)) for a in 2 * np.pi * np.arange(3) / 3)
    )
    segments = [
        Segment(
            length=0.5, young_modulus=1e6, poisson_ratio=0.5, density=rho, damping=1e4, radius=0.02
        )
        for rho in densities
    ]
    scene = Scene(name="two", segments=segments, tendons=tendons)
    model = ste.build_model(scene.replace({"integrator.step": step}))
    fine = ste.build_model(scene.replace({"integrator.step": 0.0005}))
    tension = [10.0, 0.0, 3.0]
    motion = ste.simulate(model, tension, 1.0, 0.05)
    finer = ste.simulate(fine, tension, 1.0, 0.05)
    measured("to steps of 0.5 ms [mm]", 1e3 * tip_distance(motion.tip_pose, finer.tip_pose))
    assert np.abs(motion.q).max() < 20.0
    assert tip_distance(motion.tip_pose, finer.tip_pose) < 0.02


@pytest.fixture(scope="module")
def column(one_segment):
    """column(part): an arm that stands up against gravity, `part` times as stiff as would just
    carry it (8 E I / L^2 = weight)."""

    def build(part):
        length = 0.5
        radius = 0.01
        density = 1000.0
        weight = density * np.pi * radius**2 * 9.81 * length**3
        stiffness = 7.837 * np.pi * radius**4 / 4
        critical = weight / stiffness
        passive = {"strains": ["torsion", "bend_y", "bend_z"], "order": 2, "span": "rod"}
        return one_segment(
            length=length,
            radius=radius,
            density=density,
            young_modulus=part * critical,
            damping=1e5,
            changes={
                "effects.gravity": {"acceleration": [-9.81, 0.0, 0.0]},
                "strain.passive": [passive],
            },
        )

    return build


@pytest.mark.parametrize(
    "part", [1.05, 0.7, *(pytest.param(part, marks=pytest.mark.slow) for part in (3.0, 0.95, 0.5))]
)
def test_column_under_its_own_weight(column, measured, part):
    """Gravity along the axis of an arm that points up: below the critical stiffness the straight
    arm is an equilibrium, but no stable one. Expected: statics stop at the straight equilibrium
    under Greenhill's load, to 1 %, or find it from a guess and call it unstable; its stiffness is
    indefinite exactly below Greenhill's limit; after a small push sideways a stiff arm straightens
    up and a soft one ends bent, both in an equilibrium, the bent one as far off the axis as statics
    settle, to 1 %."""
    model = column(part)
    slack = np.zeros(3)
    loaded = static_equilibrium(model, slack)
    settled = static_equilibrium(model, slack, settle=True)
    measured("load reached / Greenhill's", loaded.load / min(part, 1.0))
    assert loaded.converged == (part > 1)
    assert loaded.load == pytest.approx(min(part, 1.0), rel=0.01)
    assert settled.converged
    straight = static_equilibrium(model, slack, loaded.q)
    stiffness = (
        Balance(model, slack, make_workspace(model.arm)).linearise(straight.q, 1.0).stiffness
    )
    symmetric = 0.5 * (stiffness + stiffness.T)
    least = np.linalg.eigvalsh(symmetric)[0]
    assert straight.converged
    assert straight.stable == (part > 1)
    across = straight.tip_pose[1:3, 3]
    assert np.abs(across).max() < 1e-9
    assert (least > 0) == (part > 1)
    motion = ste.simulate(model, [0.05, 0.0, 0.0], 0.1, 0.1)
    motion = ste.simulate(model, slack, 200.0, 1.0, initial=motion.final)
    q = motion.final.q
    terms = model.terms(q, 0 * q)
    unbalanced = np.sqrt(
        (f := terms.elastic_force - terms.external_force) @ np.linalg.solve(terms.stiffness, f)
    )
    measured(
        "tip off the axis at the end, part of the length",
        np.linalg.norm(motion.tip_pose[-1, 1:3, 3]) / 0.5,
    )
    volume = np.pi * 0.01**2 * 0.5 * 1000.0
    scale = np.sqrt(volume * 9.81 * 0.5)
    assert np.isfinite(motion.tip_pose).all()
    assert unbalanced < 0.01 * scale
    distance = np.linalg.norm(motion.tip_pose[-1, 1:3, 3])
    assert (distance > 0.1) == (part < 1)  # it falls to any side
    poses = (motion.tip_pose[-1], settled.tip_pose)
    off_axis = [np.linalg.norm(pose[1:3, 3]) for pose in poses]
    expected = pytest.approx(off_axis[1], rel=0.01, abs=1e-3)
    assert off_axis[0] == expected


def test_column_that_nobody_disturbs(column, measured):
    """The soft column again, let go exactly straight: symmetry is broken by round-off alone.
    Expected: it stays straight for the first half second, to 1e-9 m, while the disturbed one has
    already fallen."""
    model = column(0.5)
    simulation = ste.Simulation(model)
    motion = ste.simulate(model, np.zeros(3), 0.5, 0.05, simulation.state)
    sideways = motion.tip_pose[:, 1:3, 3]
    measured("tip off the axis [m]", np.abs(sideways).max())
    across = motion.tip_pose[:, 1:3, 3]
    assert np.abs(across).max() < 1e-9
