"""The seam of the effects: each one that a table names is called once, in order, with its own
parameters; the others do not exist. Slopes of wrenches by differences."""

import pickle

import numpy as np
import pytest
from scipy.linalg import expm

from soft_tendon_env.compiler.compilation import kernel
from soft_tendon_env.mechanics.algebra.lanes import LANES
from soft_tendon_env.mechanics.algebra.structs import Struct
from soft_tendon_env.mechanics.effects import EffectTable, adds_wrench
from soft_tendon_env.mechanics.terms.evaluate import evaluate
from soft_tendon_env.mechanics.terms.external_forces import add_differences, displace, rest_states
from soft_tendon_env.mechanics.types import node_field
from soft_tendon_env.mechanics.workspace import make_workspace


class Plus(Struct):
    amount: float


class Times(Struct):
    factor: float
    offset: tuple[float, float]


@adds_wrench(Plus)
@kernel
def _plus(effect, nodes):
    nodes.wrench[0] += effect.amount


@adds_wrench(Times)
@kernel
def _times(effect, nodes):
    scaled = nodes.wrench[0] * effect.factor
    nodes.wrench[0] = scaled + effect.offset[0] - effect.offset[1]


def with_effects(model, *parameters):
    """The model's arm with effects that have these parameters."""
    states = [np.zeros(0) for _ in parameters]
    return model.arm.replaced(effects=EffectTable(parameters, states))


def evaluate_at(arm, q):
    """The workspace after an evaluation without tensions."""
    work = make_workspace(arm)
    work.strain.xi[:] = arm.rod.reference_strain
    u = np.zeros(arm.tendons.size)
    q_dot = np.zeros(q.size)
    assert evaluate(arm, u, q, q_dot, 1e-12, work) == -1
    return work


@pytest.mark.no_jit
@pytest.mark.parametrize(
    ("effects", "result"),
    [
        ((Plus(2.0),), 2.0),
        ((Plus(2.0), Times(10.0, (4.0, 1.0))), 23.0),
        ((Times(10.0, (4.0, 1.0)), Plus(2.0)), 5.0),
        ((Plus(1.0), Plus(2.0), Plus(3.0)), 6.0),
    ],
    ids=["plus", "plus, times", "times, plus", "three"],
)
def test_the_effects_of_the_table_act_in_order(build, effects, result):
    model = build("four_tendon")
    assert (
        evaluate_at(with_effects(model, *effects), np.zeros(model.coordinate_count)).loads.wrench[0]
        == result
    )


def test_parameters_that_do_not_fit_their_class_are_refused():
    with pytest.raises(TypeError, match="Plus should get amount, not 1.0, 2.0"):
        Plus(1.0, 2.0)
    with pytest.raises(
        TypeError, match="Plus.amount should be a contiguous array .*, or a number, not 'x'"
    ):
        Plus("x")
    with pytest.raises(
        TypeError,
        match="should be a class derived from soft_tendon_env.effects.Struct, not <class 'tuple'>",
    ):
        adds_wrench(tuple)
    with pytest.raises(
        ValueError, match="implicit is .'speed',.: it should name pose, twist or both"
    ):
        adds_wrench(Plus, implicit=("speed",))


def test_a_pickled_table_finds_its_kernels(build):
    """Addresses of machine code mean nothing in another process, so they are not what is
    pickled."""
    model = build("four_tendon")
    arm = with_effects(model, Plus(2.0), Times(10.0, (4.0, 1.0)))
    text = pickle.dumps(arm)
    address = int(arm.effects.wrench[0])
    assert str(address).encode() not in text
    copy = pickle.loads(text)
    q = np.zeros(model.coordinate_count)
    assert evaluate_at(copy, q).loads.wrench[0] == 23.0


@pytest.mark.no_jit
def test_effects_at_rest_are_in_the_states_that_they_begin_with(build):
    model = build("three_tendon", {"quadrature.intervals": 2})
    states = [np.array([3.0, 4.0]), np.array([5.0])]
    arm = model.arm.replaced(effects=EffectTable((Plus(1.0), Plus(2.0)), states))
    work = make_workspace(arm)
    work.inputs.state[:] = -1.0
    rest_states(arm, np.zeros(3), work.inputs, work.strain, work.loads)
    np.testing.assert_array_equal(work.inputs.state, [3.0, 4.0, 5.0])


@pytest.mark.no_jit
def test_differences_of_wrenches_add_up_to_the_symmetric_part_of_their_slopes():
    """W = W0 - K x of a stiffness K (6, 6), which a displacement x of each kind tells a column
    of."""
    random = np.random.default_rng(0)
    K, W0 = random.normal(size=(2, 6, 6))
    wrenches = W0[:LANES]
    way = 0.01
    blocks = np.zeros(21 * LANES)
    for k in range(6):
        moved = node_field(wrenches - way * K[:, k])
        add_differences(k, way, moved, node_field(wrenches), blocks)
    symmetric = 0.5 * (K + K.T)
    lower = symmetric[np.tril_indices(6)]
    every_lane = np.repeat(lower, LANES)
    np.testing.assert_allclose(blocks, every_lane, atol=1e-12)


@pytest.mark.no_jit
@pytest.mark.parametrize("k", range(6))
def test_poses_are_displaced_along_a_twist_in_their_own_frames(k):
    """By exp(way e_k), to first order."""
    way = 1e-5
    unit = np.zeros(6)
    unit[k] = way
    a, b, c = unit[:3]
    v = unit[3:]
    twist = np.zeros((4, 4))
    twist[:3, :3] = [[0.0, -c, b], [c, 0.0, -a], [-b, a, 0.0]]
    twist[:3, 3] = v
    turned = np.array([[0.0, -0.7, 0.4], [0.7, 0.0, 0.2], [-0.4, -0.2, 0.0]])
    pose = np.eye(4)
    pose[:3, :3] = expm(turned)
    pose[:3, 3] = [0.1, -0.2, 0.3]
    moved = pose @ expm(twist)
    fields = []
    for matrix in (pose, moved):
        R = matrix[:3, :3].ravel()
        r = matrix[:3, 3]
        rows = np.tile([*R, *r], (LANES, 1))
        fields.append(node_field(rows))
    field, expected = fields
    displace(field, k, way)
    np.testing.assert_allclose(field, expected, atol=way**2)
