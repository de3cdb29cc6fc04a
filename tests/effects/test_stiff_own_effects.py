"""A user's own stiff effects, without derivatives by hand: stable at steps of 20 ms where `implicit` names what they depend on."""

import numpy as np
import pytest

import soft_tendon_env as ste
from soft_tendon_env.differentiable import gradient_accuracy
from soft_tendon_env.effects import LANES, Effect, Struct, adds_wrench, kernel, register_effect
from soft_tendon_env.effects.base import EFFECTS

RATE = 1e5  # [1/s]
STIFFNESS = 1e5  # [N/m]
ANCHOR = (0.295, 0.01, -0.02)


class Drag(Struct):
    rate: float


class ImplicitDrag(Drag):
    """The same, in the implicit step."""


class Spring(Struct):
    stiffness: float
    anchor: tuple[float, float, float]


class ImplicitSpring(Spring):
    """The same, in the implicit step."""


@adds_wrench(Drag)
@adds_wrench(ImplicitDrag, implicit=("twist",))
@kernel
def drag(own, nodes):
    """-rate M eta."""
    for i in range(nodes.wrench.size):
        nodes.wrench[i] -= own.rate * nodes.inertia[i] * nodes.twist[i]


@adds_wrench(Spring)
@adds_wrench(ImplicitSpring, implicit=("pose",))
@kernel
def spring(own, nodes):
    """stiffness (anchor - r) at the tip, in its frame."""
    last = nodes.packs - 1
    pose, at = last * 12 * LANES + LANES - 1, last * 6 * LANES + LANES - 1
    for k in range(3):
        for i in range(3):
            force = own.stiffness * (own.anchor[i] - nodes.pose[pose + (9 + i) * LANES])
            nodes.wrench[at + (3 + k) * LANES] += nodes.pose[pose + (3 * i + k) * LANES] * force


@pytest.fixture
def stiff(monkeypatch, build):
    """stiff(parameters): a model of a bare arm with a stiff effect."""
    monkeypatch.setattr("soft_tendon_env.effects.base.EFFECTS", dict(EFFECTS))

    def make(own):
        @register_effect("own")
        class Own(Effect):
            def parameters(self, rod):
                return own

        return build("three_tendon", {"effects.own": {}})

    return make


