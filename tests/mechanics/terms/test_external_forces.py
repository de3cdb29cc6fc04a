"""The seam of the effects: each one that a table names is called once, in order, with its own parameters; the others do not exist."""

import pickle

import numpy as np
import pytest

from soft_tendon_env.compiler.compilation import kernel
from soft_tendon_env.mechanics.algebra.lanes import LANES
from soft_tendon_env.mechanics.algebra.structs import Struct
from soft_tendon_env.mechanics.effects import EffectTable, adds_stress, adds_wrench
from soft_tendon_env.mechanics.terms.evaluate import evaluate, evaluate_at_rest
from soft_tendon_env.mechanics.terms.external_forces import add_implicit, remember
from soft_tendon_env.mechanics.workspace import make_workspace

TOLERANCE = 1e-12


class Plus(Struct):
    amount: float


class Times(Struct):
    factor: float
    offset: tuple[float, float]


class Many(Struct):
    number: float
    flag: bool
    triple: tuple[float, float, float]
    row: np.ndarray
    last: float
    table: np.ndarray


class Raises(Struct):
    dummy: float


class Springs(Struct):
    stiffness: np.ndarray
    damping: float


class Relaxes(Struct):
    modulus: float
    time: float


@adds_wrench(Plus)
@kernel
def _plus(effect, nodes):
    nodes.wrench[0] += effect.amount


@adds_wrench(Times)
@kernel
def _times(effect, nodes):
    nodes.wrench[0] = nodes.wrench[0] * effect.factor + effect.offset[0] - effect.offset[1]


@adds_wrench(Many)
@kernel
def _many(effect, nodes):
    nodes.wrench[0] += effect.number if effect.flag else -effect.number
    for i in range(3):
        nodes.wrench[1 + i] = effect.triple[i]
    for i in range(effect.row.size):
        nodes.wrench[4 + i] = effect.row[i]
    nodes.wrench[10] = effect.last
    for i in range(effect.table.shape[0]):
        for j in range(effect.table.shape[1]):
            nodes.wrench[11 + 2 * i + j] = effect.table[i, j]


@adds_wrench(Raises)
@kernel
def _raises(effect, nodes):
    raise ValueError("called")


@adds_wrench(Springs)
@kernel
def _springs(springs, nodes):
    for pack in range(nodes.packs):
        for lane in range(LANES):
            for i in range(21):
                nodes.stiffness[(pack * 21 + i) * LANES + lane] += springs.stiffness[pack * LANES + lane, i]
                nodes.damping[(pack * 21 + i) * LANES + lane] += springs.damping * springs.stiffness[pack * LANES + lane, i]


@adds_stress(Relaxes)
@kernel
def _relaxing_stress(relaxes, points):
    share = 1.0 - np.exp(-points.since / relaxes.time)
    for i in range(points.strain.size):
        strain = points.strain[i] - points.reference[i]
        points.state[i] += share * (strain - points.state[i])
        points.stress[i] += relaxes.modulus * (strain - points.state[i])
        points.stiffness[i] += relaxes.modulus


def with_effects(model, *parameters, states=None):
    """The model's arm with effects that have these parameters."""
    states = [np.zeros(0) for _ in parameters] if states is None else states
    return model.arm.replaced(effects=EffectTable(parameters, states))


def evaluated(arm, q, q_dot=None):
    """The workspace after an evaluation without tensions."""
    work = make_workspace(arm)
    work.xi[:] = arm.rod.reference_strain
    assert evaluate(arm, np.zeros(arm.tendons.size), q, np.zeros(q.size) if q_dot is None else q_dot, TOLERANCE, work) == -1
    return work


@pytest.mark.no_jit
@pytest.mark.parametrize(
    ("effects", "result"),
    [
        ((Plus(2.0),), 2.0),
        ((Plus(2.0), Times(10.0, (4.0, 1.0))), 23.0),
        ((Times(10.0, (4.0, 1.0)), Plus(2.0)), 5.0),
        ((Plus(1.0), Plus(2.0), Plus(3.0)), 6.0),
        ((Many(2.0, False, (0.0, 0.0, 0.0), np.zeros(0), 0.0, np.zeros((0, 2))),), -2.0),
    ],
    ids=["plus", "plus, times", "times, plus", "three", "many"],
)
def test_the_effects_of_the_table_act_in_order(build, effects, result):
    model = build("four_tendon")
    assert evaluated(with_effects(model, *effects), np.zeros(model.coordinate_count)).wrench[0] == result


@pytest.mark.no_jit
def test_parameters_of_every_kind_arrive(build):
    model = build("four_tendon")
    many = Many(1.0, True, (2.0, 3.0, 4.0), np.array([5.0, 6.0]), 7.0, np.array([[8.0, 9.0], [10.0, 11.0]]))
    wrench = evaluated(with_effects(model, many), np.zeros(model.coordinate_count)).wrench
    np.testing.assert_array_equal(wrench[:6], [1.0, 2.0, 3.0, 4.0, 5.0, 6.0])
    np.testing.assert_array_equal(wrench[10:15], [7.0, 8.0, 9.0, 10.0, 11.0])


def test_parameters_that_do_not_fit_their_class_are_refused():
    with pytest.raises(TypeError, match="Plus should get amount, not 1.0, 2.0"):
        Plus(1.0, 2.0)
    with pytest.raises(TypeError, match="Plus.amount should be a contiguous array .* or a number, not 'x'"):
        Plus("x")
    with pytest.raises(TypeError, match="should be a class derived from soft_tendon_env.effects.Struct, not <class 'tuple'>"):
        adds_wrench(tuple)
    with pytest.raises(ValueError, match="implicit is .'speed',.: it should name pose, twist or both"):
        adds_wrench(Plus, implicit=("speed",))


@pytest.mark.no_jit
def test_an_effect_outside_the_table_is_not_called(build):
    model = build("four_tendon")
    q = np.zeros(model.coordinate_count)
    with pytest.raises(ValueError, match="called"):
        evaluated(with_effects(model, Raises(0.0)), q)
    evaluated(with_effects(model, Plus(1.0)), q)


def test_a_scene_without_effects_calls_and_compiles_none(build):
    """One machine code serves arms with and without effects: an effect adds none to it."""
    bare, heavy = build("paper"), build("paper", {"effects.gravity.acceleration": [0.0, 0.0, -9.81]})
    assert bare.arm.effects.count == 0 and heavy.arm.effects.count == 1
    bare.terms(np.zeros(10), np.zeros(10))
    before = dict(evaluate.kernel.from_kernels.overloads)
    heavy.terms(np.zeros(10), np.zeros(10))
    assert evaluate.kernel.from_kernels.overloads == before
    assert not np.any(bare.terms(np.zeros(10), np.zeros(10)).external_force)


def test_a_pickled_table_finds_its_kernels(build):
    """Addresses of machine code mean nothing in another process, so they are not what is pickled."""
    model = build("four_tendon")
    arm = with_effects(model, Plus(2.0), Times(10.0, (4.0, 1.0)))
    text = pickle.dumps(arm)
    assert str(int(arm.effects.wrench[0])).encode() not in text
    copy = pickle.loads(text)
    assert evaluated(copy, np.zeros(model.coordinate_count)).wrench[0] == 23.0


def symmetric(blocks):
    """Matrices (.., 6, 6) of their lower triangles (.., 21)."""
    matrices = np.zeros((*blocks.shape[:-1], 6, 6))
    rows, columns = np.tril_indices(6)
    matrices[..., rows, columns] = matrices[..., columns, rows] = blocks
    return matrices


def by_node(field, components):
    """A field over nodes as (.., nodes, components)."""
    packed = field.reshape(*field.shape[:-1], -1, components, LANES)
    return np.moveaxis(packed, -1, -2).reshape(*field.shape[:-1], -1, components)


@pytest.mark.no_jit
@pytest.mark.parametrize("stiff", [slice(None), slice(4, 8), slice(0, 0)], ids=["everywhere", "in one pack", "nowhere"])
def test_stiffness_and_damping_of_nodes_in_the_step(build, stiff):
    """G + sum J^T K J and D + sum J^T C J, over the nodes that have any."""
    model = build("four_tendon")
    rng = np.random.default_rng(3)
    nodes, n = model.arm.rod.length.size, model.coordinate_count
    blocks = np.zeros((nodes, 21))
    blocks[stiff] = rng.normal(size=blocks[stiff].shape)
    arm, q = with_effects(model, Springs(blocks, 0.1)), model.rest_coordinates([2.0, 0.0, 1.0, 0.0])
    work = evaluated(arm, q)
    D, G = work.D.copy(), work.G.copy()
    add_implicit(arm, work)
    J = by_node(work.J.reshape(n, -1), 6)
    added = np.einsum("ika,kab,jkb->ij", J, symmetric(blocks), J)
    scale = np.abs(added).max() + 1e-12
    np.testing.assert_allclose(work.G - G, added, rtol=0, atol=1e-12 * scale + 1e-14 * np.abs(G).max())
    np.testing.assert_allclose(work.D - D, 0.1 * added, rtol=0, atol=1e-12 * scale + 1e-14 * np.abs(D).max())


@pytest.mark.no_jit
def test_stress_and_its_state(build):
    """F = - int Phi^T sigma dX; a state that has rested carries no stress, and its stiffness int Phi^T E Phi dX enters the step."""
    model = build("four_tendon")
    size, n = model.arm.rod.reference_strain.size, model.coordinate_count
    arm = with_effects(model, Relaxes(2.0, 0.1), states=[np.zeros(size)])
    q, u = model.rest_coordinates([2.0, 0.0, 1.0, 0.0]), np.zeros(4)
    work = evaluated(arm, q)
    weight = np.repeat(model.arm.rod.weight.reshape(-1, 1, LANES), 6, axis=1).ravel()
    Phi, strain = work.Phi.reshape(n, -1), work.xi - model.arm.rod.reference_strain
    np.testing.assert_allclose(work.load, -Phi @ (2.0 * weight * strain), rtol=1e-10)
    G = work.G.copy()
    add_implicit(arm, work)
    np.testing.assert_allclose(work.G - G, 2.0 * Phi * weight @ Phi.T, rtol=0, atol=1e-9 * np.abs(G).max())

    work.since[0] = 0.1 * np.log(2.0)
    remember(arm, work)
    np.testing.assert_allclose(work.state, 0.5 * strain, rtol=1e-9, atol=1e-15)

    assert evaluate_at_rest(arm, u, q, TOLERANCE, work) == -1
    np.testing.assert_allclose(work.state, strain, rtol=1e-9, atol=1e-15)
    assert np.abs(work.load).max() < 1e-9
