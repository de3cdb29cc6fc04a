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
    for m in range(effect.first * PER_PACK, effect.behind * PER_PACK):
        strained = points.strain[m] - points.reference[m]
        points.stress[m] += effect.stiffness * strained + effect.damping * points.rate[m]
        points.stiffness[m] += effect.stiffness
        points.damping[m] += effect.damping


@adds_wrench(Springs, implicit=("pose",))
@kernel
def _springs(effect, nodes):
    for node in range(effect.places.size):
        pose = node // LANES * 12 * LANES + node % LANES
        wrench = node // LANES * 6 * LANES + node % LANES
        for j in range(3):
            for i in range(3):
                place = effect.places[node] if i == 0 else 0.0
                away = nodes.pose[pose + (9 + i) * LANES] - place
                turned = nodes.pose[pose + (3 * i + j) * LANES]
                nodes.wrench[wrench + (3 + j) * LANES] -= effect.stiffness * turned * away


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
            for lane in range(LANES):
                turned = nodes.pose[(pack * 12 + 6 + j) * LANES + lane]
                nodes.wrench[(pack * 6 + 3 + j) * LANES + lane] += effect.force * turned


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
    effects = EffectTable((parameters,), [np.array(state)])
    return Model(model.scene, model.grid, model.arm.replaced(effects=effects))


Q = np.array([1.0, 0.8, -2.0])
RATES = np.array([20.0, -10.0, 5.0])


@pytest.mark.parametrize(("first", "behind"), [(0, 3), (1, 2), (2, 3)])
def test_stresses_are_forces_along_the_strains_of_their_part(bare, first, behind):
    """(k q + c q_dot) l against curvatures over a length l, with the derivatives k l and c l."""
    model = with_effect(bare, Sleeve(first, behind, STIFFNESS, DAMPING))
    terms = model.terms(Q, RATES)
    length = model.grid.length[first * LANES : behind * LANES].sum()
    resisted = STIFFNESS * Q + DAMPING * RATES
    np.testing.assert_allclose(terms.external_force, -length * resisted, rtol=1e-12)
    unit = length * np.eye(3)
    size = 1e-12 * length
    np.testing.assert_allclose(terms.external_stiffness, STIFFNESS * unit, atol=size)
    np.testing.assert_allclose(terms.external_damping, DAMPING * unit, atol=size)
    # the rod's own are those without
    np.testing.assert_array_equal(terms.stiffness, bare.terms(Q, RATES).stiffness)


def test_packs_with_entries_are_found():
    field = np.zeros(5 * 2 * LANES)
    assert filled_packs(field, 2 * LANES) == (0, 0)
    field[2 * 2 * LANES - 1] = 1e-9
    assert filled_packs(field, 2 * LANES) == (1, 2)
    field[3 * 2 * LANES] = -1.0
    assert filled_packs(field, 2 * LANES) == (1, 4)
    field[0] = 2.0
    assert filled_packs(field, 2 * LANES) == (0, 4)


def slopes_of(force, at, step):
    """Derivatives (n, n) of -force by its arguments, by central differences."""
    columns = []
    for way in step * np.eye(at.size):
        change = force(at - way) - force(at + way)
        columns.append(change / (2.0 * step))
    return np.transpose(columns)


def test_springs_of_the_nodes_stiffen_the_arm(bare):
    """By their derivative where they are at rest, and not by damping."""
    places = bare.grid.start + bare.grid.length
    model = with_effect(bare, Springs(5.0, places))
    straight = np.zeros(3)
    terms = model.terms(straight, RATES)
    np.testing.assert_allclose(terms.external_force, 0.0, atol=1e-12)
    expected = slopes_of(lambda q: model.terms(q, straight).external_force, straight, 1e-5)
    size = np.abs(expected).max()
    assert size > 0.01
    np.testing.assert_allclose(terms.external_stiffness, expected, atol=1e-5 * size)
    np.testing.assert_array_equal(terms.external_damping, 0.0)


def test_drag_of_the_nodes_damps_the_arm(bare):
    """By its derivative at any coordinates, and not by stiffness."""
    model = with_effect(bare, Drag(0.3))
    terms = model.terms(Q, RATES)
    expected = slopes_of(lambda v: model.terms(Q, v).external_force, RATES, 1e-3)
    size = np.abs(expected).max()
    np.testing.assert_allclose(terms.external_damping, expected, atol=1e-5 * size)
    np.testing.assert_allclose(terms.external_force, -expected @ RATES, rtol=1e-6)
    np.testing.assert_array_equal(terms.external_stiffness, 0.0)


def test_dead_forces_are_not_stiff(bare):
    """Their wrenches turn with the nodes, and that is not their stiffness."""
    model = with_effect(bare, Weight(0.1))
    terms = model.terms(Q, RATES)
    nodes = model.grid.start + model.grid.length

    def height(q):
        return model.backbone_at(q, nodes)[:, 2, 3].sum()

    h = 1e-5
    work = [0.1 * (height(Q + way) - height(Q - way)) / (2 * h) for way in h * np.eye(3)]
    np.testing.assert_allclose(terms.external_force, work, rtol=1e-6)
    size = np.abs(terms.external_force).max()
    np.testing.assert_allclose(terms.external_stiffness, 0.0, atol=1e-7 * size)


def remembering(model, value):
    """The model with a memory, all of whose states have a value."""
    size = model.arm.rod.reference_strain.size
    return with_effect(model, Memory(STIFFNESS), np.full(size, value))


def test_memories_of_an_arm_at_rest_are_those_of_its_strain(bare):
    model = remembering(bare, 7.0)
    work = make_workspace(model.arm)
    work.strain.xi[:] = model.packed_strain(Q)
    rest_states(model.arm, np.zeros(3), work.inputs, work.strain, work.loads)
    expected = work.strain.xi - model.arm.rod.reference_strain
    np.testing.assert_array_equal(work.inputs.state, expected)
    assert work.inputs.since[0] == 0.0
    # an evaluation leaves them
    failed = evaluate(model.arm, np.zeros(3), Q, RATES, 1e-12, work)
    assert failed == -1
    np.testing.assert_array_equal(work.inputs.state, expected)
    np.testing.assert_allclose(work.forces.load, -STIFFNESS * 0.3 * Q, rtol=1e-12)


def test_the_balance_at_rest_is_that_of_memories_at_rest(bare):
    """Whatever has been remembered: -k q L, without twists of the base."""
    model = remembering(bare, 7.0)
    work = make_workspace(model.arm)
    work.kinematics.base[12:] = 1.0
    work.strain.xi[:] = model.packed_strain(Q)
    failed = balance_at_rest(model.arm, np.zeros(3), Q, 1e-12, work)
    assert failed == -1
    np.testing.assert_allclose(work.forces.load, -STIFFNESS * 0.3 * Q, rtol=1e-12)
    assert work.inputs.since[0] == 0.0
    assert not work.kinematics.base[12:].any()
    # without effects there is no load, whatever stood there
    work = make_workspace(bare.arm)
    work.forces.load[:] = 3.0
    work.strain.xi[:] = bare.packed_strain(Q)
    balance_at_rest(bare.arm, np.zeros(3), Q, 1e-12, work)
    assert not work.forces.load.any()
    work.forces.load[:] = 3.0
    evaluate(bare.arm, np.zeros(3), Q, RATES, 1e-12, work)
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
    table = EffectTable([parameters for parameters, _ in parts], states)
    together = Model(bare.scene, bare.grid, bare.arm.replaced(effects=table))
    alone = [with_effect(bare, *part).terms(Q, RATES) for part in parts]
    # an evaluation, and another one in the same workspace
    for found in (together.terms(Q, RATES), together.terms(Q, RATES)):
        for field in ("external_force", "external_stiffness", "external_damping"):
            expected = sum(getattr(terms, field) for terms in alone)
            atol = 1e-6 * np.abs(expected).max()
            np.testing.assert_allclose(getattr(found, field), expected, atol=atol)


def test_bases_that_nothing_moves_are_where_the_scene_has_them(bare):
    """Whatever stood there before."""
    upright = {"base.position": [0.1, -0.2, 0.3], "base.rotation": [0.0, -90.0, 0.0]}
    model = bare.with_scene(bare.scene.replace(upright))
    base = np.full(24, 9.0)
    place_base(model.arm, 0.0, base)
    rotation = base[:9].reshape(3, 3)
    np.testing.assert_allclose(rotation @ [1.0, 0.0, 0.0], [0.0, 0.0, 1.0], atol=1e-12)
    np.testing.assert_allclose(base[9:12], [0.1, -0.2, 0.3])


def test_an_evaluation_at_rest_is_that_of_no_rates(bare):
    """With all matrices, whatever an evaluation in motion has left."""
    model = with_effect(bare, Weight(0.1))
    tension = np.array([2.0, 0.5, 1.0])
    still = np.zeros(3)
    work = make_workspace(model.arm)
    work.strain.xi[:] = model.packed_strain(-Q)
    assert evaluate(model.arm, still, -Q, RATES, 1e-12, work) == -1
    assert evaluate_at_rest(model.arm, tension, Q, 1e-12, work) == -1
    terms = model.terms(Q, still, tension)
    expected = terms.actuation @ tension - terms.elastic_force
    np.testing.assert_allclose(work.forces.drive, expected, rtol=1e-9, atol=1e-15)
    np.testing.assert_allclose(work.forces.load, terms.external_force, rtol=1e-12)
    np.testing.assert_array_equal(work.forces.bias, 0.0)
    for found, of_terms in (
        (work.matrices.M, terms.mass),
        (work.matrices.D, terms.damping),
        (work.matrices.G, terms.stiffness),
    ):
        size = np.abs(of_terms).max()
        np.testing.assert_allclose(found, of_terms, rtol=1e-9, atol=1e-12 * size)
