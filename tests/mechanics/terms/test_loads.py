"""The seam of the effects: each one that a tuple names is called once, in order, and the others do not exist."""

from typing import NamedTuple

import numba
import numpy as np
import pytest

from soft_tendon_env.mechanics.terms.evaluate import evaluate
from soft_tendon_env.mechanics.terms.loads import adds_wrench, apply_effects
from soft_tendon_env.tools.compilation import kernel


class Plus(NamedTuple):
    amount: float


class Times(NamedTuple):
    factor: float
    offset: float


class Raises(NamedTuple):
    dummy: float


@adds_wrench(Plus)
@kernel
def _plus(effect, rod, work):
    work[0] += effect.amount


@adds_wrench(Times)
@kernel
def _times(effect, rod, work):
    work[0] = work[0] * effect.factor + effect.offset * rod[0]


@adds_wrench(Raises)
@kernel
def _raises(effect, rod, work):
    raise ValueError("called")


@kernel
def walk(effects, rod, work):
    apply_effects(effects, rod, work)


@pytest.mark.no_jit
@pytest.mark.parametrize(
    ("effects", "result"),
    [
        ((), 1.0),
        ((Plus(2.0),), 3.0),
        ((Plus(2.0), Times(10.0, 3.0)), 36.0),
        ((Times(10.0, 3.0), Plus(2.0)), 18.0),
        ((Plus(1.0), Plus(2.0), Plus(3.0)), 7.0),
    ],
    ids=str,
)
def test_the_effects_of_the_tuple_act_in_order(effects, result):
    rod, work = np.array([2.0]), np.array([1.0])
    walk(effects, rod, work)
    assert work[0] == result


@pytest.mark.no_jit
def test_an_effect_outside_the_tuple_is_not_called():
    work = np.array([1.0])
    with pytest.raises(ValueError, match="called"):
        walk((Raises(0.0),), work, work)
    walk((Plus(1.0),), work, work)


def test_a_scene_without_effects_compiles_none_of_them(build):
    """The kernels of gravity stand in the machine code of a scene that has it, and in no other."""
    bare, heavy = build("paper"), build("paper", {"effects.gravity.acceleration": [0.0, 0.0, -9.81]})
    assert bare.arm.effects == () and [type(effect).__name__ for effect in heavy.arm.effects] == ["GravityParameters"]
    q = np.zeros(10)
    for model in (bare, heavy):
        model.terms(q, q)
    of_effects = {numba.typeof(model.arm)[3]: model for model in (bare, heavy)}
    overloads = {signature[0][3]: result for signature, result in evaluate.overloads.items() if signature[0][3] in of_effects}
    assert {model.arm.effects: len(kind) for kind, model in of_effects.items()} == {(): 0, heavy.arm.effects: 1}
    assert len(overloads) == 2
