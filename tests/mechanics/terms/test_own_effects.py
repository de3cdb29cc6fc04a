"""Effects of one's own: stresses and wrenches as generalised forces, their shares of stiffness and
damping by differences, and what an arm at rest remembers."""

import numpy as np
import pytest

from soft_tendon_env.compiler.compilation import kernel
from soft_tendon_env.mechanics.algebra.lanes import LANES
from soft_tendon_env.mechanics.algebra.structs import Struct
from soft_tendon_env.mechanics.effects import EffectTable, adds_stress, adds_wrench
from soft_tendon_env.mechanics.terms.evaluate import balance_at_rest, evaluate, evaluate_at_rest
from soft_tendon_env.mechanics.terms.external_forces import (
    filled_packs,
    place_base,
    rest_states,
)
from soft_tendon_env.mechanics.workspace import make_workspace
from soft_tendon_env.model.model import Model, model_on
from soft_tendon_env.scene.file import load_scene

pytestmark = pytest.mark.no_jit

PER_PACK = 12 * LANES
STIFFNESS = 0.02
DAMPING = 0.003
CURVATURES = {
    "strain": {
        "type": "explicit",
        "modes": [{"strains": ["torsion", "bend_y", "bend_z"], "order": 0, "span": "rod"}],
    }
}


class Sleeve(Struct):
    """An elastic and viscous sleeve around some packs of the rod."""

    first: int
    behind: int
    stiffness: float
    damping: float


class Springs(Struct):
    """Springs from all nodes to where they are on the straight arm."""

    stiffness: float
    places: np.ndarray


class Drag(Struct):
    """Forces and moments against the twist of all nodes."""

    rate: float


class Weight(Struct):
    """A dead force along z at all nodes."""

    force: float


class Memory(Struct):
    """A stress that is the integral of the strain over time."""

    modulus: float


@adds_stress(Sleeve)
@kernel
def _sleeve(effect, points):
    first = effect.first * PER_PACK
    behind = effect.behind * PER_PACK
    for m in range(first, behind):
        strained = points.strain[m] - points.reference[m]
        points.stress[m] += effect.stiffness * strained
        points.stress[m] += effect.damping * points.rate[m]
        points.stiffness[m] += effect.stiffness
        points.damping[m] += effect.damping


@adds_wrench(Springs, implicit=("pose",))
@kernel
def _springs(effect, nodes):
    for node in range(effect.places.size):
        pose = node // LANES * 12 * LANES + node % LANES
        wrench = node // LANES * 6 * LANES + node % LANES
        for j in range(3):
            component = wrench + (3 + j) * LANES
            for i in range(3):
                place = effect.places[node] if i == 0 else 0.0
                position = pose + (9 + i) * LANES
                entry = pose + (3 * i + j) * LANES
                away = nodes.pose[position] - place
                pull = effect.stiffness * away
                nodes.wrench[component] -= nodes.pose[entry] * pull


@adds_wrench(Drag, implicit=("twist",))
@kernel
def _drag(effect, nodes):
    for m in range(nodes.wrench.size):
        nodes.wrench[m] -= effect.rate * nodes.twist[m]


@adds_wrench(Weight, implicit=("pose",))
@kernel
def _weight(effect, nodes):
    for pack in range(nodes.packs):
        for j in range(3):
            last_row = (pack * 12 + 6 + j) * LANES
            component = (pack * 6 + 3 + j) * LANES
            for lane in range(LANES):
                turned = nodes.pose[last_row + lane]
                nodes.wrench[component + lane] += effect.force * turned


@adds_stress(Memory)
@kernel
def _memory(effect, points):
    for m in range(points.strain.size):
        strained = points.strain[m] - points.reference[m]
        if points.since == np.inf:
            points.state[m] = strained
        else:
            points.state[m] += points.since * strained
        points.stress[m] += effect.modulus * points.state[m]


@pytest.fixture(scope="module")
def bare():
    """An arm with three constant curvatures, on two pieces of unequal length in three packs."""
    scene = load_scene("three_tendon").replace({**CURVATURES, "tendons.0.end": 0.2})
    return model_on(scene, 6)


def with_effect(model, parameters, state=()):
    """The model with an effect that has these parameters and this internal state."""
    states = [np.array(state)]
    effects = EffectTable((parameters,), states)
    arm = model.arm.replaced(effects=effects)
    return Model(model.scene, model.grid, arm)


Q = np.array([1.0, 0.8, -2.0])
RATES = np.array([20.0, -10.0, 5.0])


@pytest.mark.parametrize(("first", "behind"), [(0, 3), (1, 2), (2, 3)])
def test_stresses_are_forces_along_the_strains_of_their_part(bare, first, behind):
    """(k q + c q_dot) l against curvatures over a length l, with the derivatives k l and c l."""
    sleeve = Sleeve(first, behind, STIFFNESS, DAMPING)
    model = with_effect(bare, sleeve)
    terms = model.terms(Q, RATES)
    own = slice(first * LANES, behind * LANES)
    length = model.grid.length[own].sum()
    elastic = STIFFNESS * Q
    viscous = DAMPING * RATES
    expected = -length * (elastic + viscous)
    np.testing.assert_allclose(terms.external_force, expected, rtol=1e-12)
    unit = length * np.eye(3)
    size = 1e-12 * length
    stiffness = STIFFNESS * unit
    damping = DAMPING * unit
    np.testing.assert_allclose(terms.external_stiffness, stiffness, atol=size)
    np.testing.assert_allclose(terms.external_damping, damping, atol=size)
    # the rod's own are those without
    without = bare.terms(Q, RATES)
    np.testing.assert_array_equal(terms.stiffness, without.stiffness)


def test_packs_with_entries_are_found():
    per_pack = 2 * LANES
    field = np.zeros(5 * per_pack)
    assert filled_packs(field, per_pack) == (0, 0)
    last_of_second = 2 * per_pack - 1
    field[last_of_second] = 1e-9
    assert filled_packs(field, per_pack) == (1, 2)
    first_of_fourth = 3 * per_pack
    field[first_of_fourth] = -1.0
    assert filled_packs(field, per_pack) == (1, 4)
    field[0] = 2.0
    assert filled_packs(field, per_pack) == (0, 4)


def slopes_of(force, at, step):
    """Derivatives (.., n) of -force by its arguments, by central differences."""
    columns = []
    for way in step * np.eye(at.size):
        before = force(at - way)
        after = force(at + way)
        change = before - after
        columns.append(change / (2.0 * step))
    return np.transpose(columns)


def test_springs_of_the_nodes_stiffen_the_arm(bare):
    """By their derivative where they are at rest, and not by damping."""
    places = bare.grid.start + bare.grid.length
    springs = Springs(5.0, places)
    model = with_effect(bare, springs)
    straight = np.zeros(3)
    terms = model.terms(straight, RATES)
    np.testing.assert_allclose(terms.external_force, 0.0, atol=1e-12)

    def force(q):
        return model.terms(q, straight).external_force

    expected = slopes_of(force, straight, 1e-5)
    size = np.abs(expected).max()
    assert size > 0.01
    atol = 1e-5 * size
    np.testing.assert_allclose(terms.external_stiffness, expected, atol=atol)
    np.testing.assert_array_equal(terms.external_damping, 0.0)


def test_drag_of_the_nodes_damps_the_arm(bare):
    """By its derivative at any coordinates, and not by stiffness."""
    drag = Drag(0.3)
    model = with_effect(bare, drag)
    terms = model.terms(Q, RATES)

    def force(rates):
        return model.terms(Q, rates).external_force

    expected = slopes_of(force, RATES, 1e-3)
    atol = 1e-5 * np.abs(expected).max()
    np.testing.assert_allclose(terms.external_damping, expected, atol=atol)
    resisting = -expected @ RATES
    np.testing.assert_allclose(terms.external_force, resisting, rtol=1e-6)
    np.testing.assert_array_equal(terms.external_stiffness, 0.0)


def test_dead_forces_are_not_stiff(bare):
    """Their wrenches turn with the nodes, and that is not their stiffness."""
    weight = Weight(0.1)
    model = with_effect(bare, weight)
    terms = model.terms(Q, RATES)
    nodes = model.grid.start + model.grid.length

    def potential(q):
        poses = model.backbone_at(q, nodes)
        heights = poses[:, 2, 3]
        return -0.1 * heights.sum()

    expected = slopes_of(potential, Q, 1e-5)
    np.testing.assert_allclose(terms.external_force, expected, rtol=1e-6)
    atol = 1e-7 * np.abs(expected).max()
    np.testing.assert_allclose(terms.external_stiffness, 0.0, atol=atol)


def remembering(model, value):
    """The model with a memory, all of whose states have a value."""
    size = model.arm.rod.reference_strain.size
    memory = Memory(STIFFNESS)
    state = np.full(size, value)
    return with_effect(model, memory, state)


def test_memories_of_an_arm_at_rest_are_those_of_its_strain(bare):
    model = remembering(bare, 7.0)
    arm = model.arm
    work = make_workspace(arm)
    work.strain.xi[:] = model.packed_strain(Q)
    slack = np.zeros(3)
    rest_states(arm, slack, work.inputs, work.strain, work.loads)
    expected = work.strain.xi - arm.rod.reference_strain
    np.testing.assert_array_equal(work.inputs.state, expected)
    assert work.inputs.since[0] == 0.0
    # an evaluation leaves them
    failed = evaluate(arm, slack, Q, RATES, 1e-12, work)
    assert failed == -1
    np.testing.assert_array_equal(work.inputs.state, expected)
    force = -STIFFNESS * model.length * Q
    np.testing.assert_allclose(work.forces.load, force, rtol=1e-12)


def test_the_balance_at_rest_is_that_of_memories_at_rest(bare):
    """Whatever has been remembered: -k q L, without twists of the base."""
    model = remembering(bare, 7.0)
    work = make_workspace(model.arm)
    work.kinematics.base[12:] = 1.0
    work.strain.xi[:] = model.packed_strain(Q)
    slack = np.zeros(3)
    failed = balance_at_rest(model.arm, slack, Q, 1e-12, work)
    assert failed == -1
    force = -STIFFNESS * model.length * Q
    np.testing.assert_allclose(work.forces.load, force, rtol=1e-12)
    assert work.inputs.since[0] == 0.0
    assert not work.kinematics.base[12:].any()
    # without effects there is no load, whatever stood there
    work = make_workspace(bare.arm)
    work.forces.load[:] = 3.0
    work.strain.xi[:] = bare.packed_strain(Q)
    balance_at_rest(bare.arm, slack, Q, 1e-12, work)
    assert not work.forces.load.any()
    work.forces.load[:] = 3.0
    evaluate(bare.arm, slack, Q, RATES, 1e-12, work)
    assert not work.forces.load.any()


def test_effects_add_up_each_with_its_own_state(bare):
    """Forces and derivatives of several are sums, in every evaluation anew."""
    places = bare.grid.start + bare.grid.length
    size = bare.arm.rod.reference_strain.size
    nothing = np.zeros(0)
    parts = [
        (Sleeve(0, 3, STIFFNESS, DAMPING), nothing),
        (Memory(STIFFNESS), np.full(size, 7.0)),
        (Springs(5.0, places), nothing),
        (Memory(2.0 * STIFFNESS), np.full(size, -3.0)),
        (Drag(0.3), nothing),
    ]
    states = [state for _, state in parts]
    every_parameters = [parameters for parameters, _ in parts]
    table = EffectTable(every_parameters, states)
    arm = bare.arm.replaced(effects=table)
    together = Model(bare.scene, bare.grid, arm)
    alone = []
    for part in parts:
        model = with_effect(bare, *part)
        alone.append(model.terms(Q, RATES))
    # an evaluation, and another one in the same workspace
    for _ in range(2):
        found = together.terms(Q, RATES)
        for field in ("external_force", "external_stiffness", "external_damping"):
            shares = [getattr(terms, field) for terms in alone]
            expected = sum(shares)
            atol = 1e-6 * np.abs(expected).max()
            of_all = getattr(found, field)
            np.testing.assert_allclose(of_all, expected, atol=atol)


def test_bases_that_nothing_moves_are_where_the_scene_has_them(bare):
    """Whatever stood there before."""
    upright = {"base.position": [0.1, -0.2, 0.3], "base.rotation": [0.0, -90.0, 0.0]}
    scene = bare.scene.replace(upright)
    arm = bare.with_scene(scene).arm
    base = np.full(24, 9.0)
    place_base(arm, 0.0, base)
    rotation = base[:9].reshape(3, 3)
    axis = rotation[:, 0]
    position = base[9:12]
    np.testing.assert_allclose(axis, [0.0, 0.0, 1.0], atol=1e-12)
    np.testing.assert_allclose(position, [0.1, -0.2, 0.3])


def test_an_evaluation_at_rest_is_that_of_no_rates(bare):
    """With all matrices, whatever an evaluation in motion has left."""
    model = with_effect(bare, Weight(0.1))
    tension = np.array([2.0, 0.5, 1.0])
    still = np.zeros(3)
    work = make_workspace(model.arm)
    work.strain.xi[:] = model.packed_strain(-Q)
    moving = evaluate(model.arm, still, -Q, RATES, 1e-12, work)
    assert moving == -1
    resting = evaluate_at_rest(model.arm, tension, Q, 1e-12, work)
    assert resting == -1
    terms = model.terms(Q, still, tension)
    pulled = terms.actuation @ tension
    expected = pulled - terms.elastic_force
    forces = work.forces
    np.testing.assert_allclose(forces.drive, expected, rtol=1e-9, atol=1e-15)
    np.testing.assert_allclose(forces.load, terms.external_force, rtol=1e-12)
    np.testing.assert_array_equal(forces.bias, 0.0)
    of_terms = {"M": terms.mass, "D": terms.damping, "G": terms.stiffness}
    for name, matrix in of_terms.items():
        found = getattr(work.matrices, name)
        atol = 1e-12 * np.abs(matrix).max()
        np.testing.assert_allclose(found, matrix, rtol=1e-9, atol=atol)
