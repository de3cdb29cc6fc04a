"""What a table of effects says of them: whether they are loads, remember, or stand between commands
and tensions; and what limits steps."""

import math

import numpy as np
import pytest

from soft_tendon_env.compiler.compilation import kernel
from soft_tendon_env.mechanics.algebra.structs import Struct
from soft_tendon_env.mechanics.effects import (
    DIRECT,
    EffectTable,
    adds_stress,
    adds_wrench,
    allow_turning,
    limits_step,
    moves_base,
)

pytestmark = pytest.mark.no_jit


class Nothing(Struct):
    size: float


class Push(Struct):
    size: float


class Strain(Struct):
    size: float


class Shake(Struct):
    size: float


class Limit(Struct):
    size: float


@adds_wrench(Push)
@kernel
def _push(effect, nodes):
    nodes.wrench[0] += effect.size


@adds_stress(Strain)
@kernel
def _strain(effect, points):
    points.stress[0] += effect.size


@moves_base(Shake)
@kernel
def _shake(effect, base):
    base.pose[9] += effect.size


@limits_step(Limit)
@kernel
def _limit(effect, nodes, longest):
    longest[0] = min(longest[0], effect.size)


@pytest.mark.parametrize(
    ("kind", "is_load"),
    [(Nothing, False), (Push, True), (Strain, True), (Shake, True), (Limit, False)],
)
def test_what_acts_on_an_arm_at_rest_is_a_load(kind, is_load):
    """Wrenches, stresses and moving bases, beside whatever else."""
    parameters = (Nothing(1.0), kind(2.0))
    table = EffectTable(parameters, [np.zeros(0)] * 2)
    assert table.load == is_load
    assert table.count == 2
    assert table.structs == parameters


@pytest.mark.parametrize(
    ("changes", "acts"),
    [
        ({}, False),
        ({"filter": 0}, True),
        ({"elastic": 1}, True),
        ({"friction": 0.1}, True),
        ({"delay": 0.1}, False),
    ],
)
def test_what_stands_between_commands_and_tensions_acts(changes, acts):
    assert DIRECT.replaced(**changes).acts == acts


def test_states_that_are_not_of_the_filter_remember():
    states = [np.array([1.0, 2.0]), np.zeros(0), np.array([3.0, 4.0, 5.0])]
    parameters = (Nothing(1.0), Nothing(2.0), Nothing(3.0))
    table = EffectTable(parameters, states)
    np.testing.assert_array_equal(table.first_state, [0, 2, 2, 5])
    np.testing.assert_array_equal(table.state, [1.0, 2.0, 3.0, 4.0, 5.0])
    assert table.filter_size == 0
    assert table.remembers
    filtered = EffectTable(parameters, states, DIRECT.replaced(filter=2))
    assert filtered.filter_size == 3
    assert filtered.remembers
    alone = [np.zeros(0), np.zeros(0), np.ones(3)]
    assert not EffectTable(parameters, alone, DIRECT.replaced(filter=2)).remembers
    assert not EffectTable(parameters, [np.zeros(0)] * 3).remembers


def test_what_turns_allows_steps_of_a_sixteenth_of_its_period():
    period = 0.5
    rate = 2.0 * math.pi / period
    for turning in (rate, -rate):
        longest = np.array([1.0])
        allow_turning(turning, longest)
        assert longest[0] == pytest.approx(period / 16.0)
    shorter = np.array([0.01])
    allow_turning(rate, shorter)
    assert shorter[0] == 0.01
    allow_turning(0.0, shorter)
    assert shorter[0] == 0.01


def test_derivatives_that_would_count_twice_are_refused():
    class Twice(Struct):
        size: float

    @kernel
    def both(effect, nodes):
        nodes.stiffness[0] += effect.size

    with pytest.raises(ValueError, match="adds to nodes.stiffness what implicit=.* counts twice"):
        adds_wrench(Twice, implicit=("pose",))(both)
    adds_wrench(Twice)(both)
    with pytest.raises(TypeError, match="parameters of an effect should be a class derived from"):
        adds_stress(float)
