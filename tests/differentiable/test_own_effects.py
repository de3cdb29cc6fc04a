"""Gradients through a user's own effects, functions of time, pose and twist without derivatives by hand, beside differences."""

import numpy as np
import pytest

from soft_tendon_env.differentiable import gradient_accuracy
from soft_tendon_env.effects import Effect, Struct, adds_wrench, kernel, register_effect
from soft_tendon_env.mechanics.algebra.lanes import LANES

LEAST, GREATEST = np.zeros(3), np.full(3, 10.0)


class Strength(Struct):
    value: float


class Magnet(Strength):
    """Force [N m^2] over the squared distance from a pole, on the tip."""


class Drag(Strength):
    """Force per mass and velocity [1/s], more at speed."""


class Jet(Strength):
    """Force [N] that turns with the tip: it has no potential."""


@adds_wrench(Magnet)
@kernel
def magnet_wrench(magnet, nodes):
    last = nodes.packs - 1
    tip, at = last * 12 * LANES + LANES - 1, last * 6 * LANES + LANES - 1
    x, y, z = 0.45 - nodes.pose[tip + 9 * LANES], 0.1 - nodes.pose[tip + 10 * LANES], -0.05 - nodes.pose[tip + 11 * LANES]
    pull = magnet.value / (x * x + y * y + z * z) ** 1.5
    for k in range(3):
        R = nodes.pose[tip + k * LANES], nodes.pose[tip + (3 + k) * LANES], nodes.pose[tip + (6 + k) * LANES]
        nodes.wrench[at + (3 + k) * LANES] += pull * (R[0] * x + R[1] * y + R[2] * z)


@adds_wrench(Drag)
@kernel
def drag_wrench(drag, nodes):
    for pack in range(nodes.packs):
        for lane in range(LANES):
            at, squares = pack * 6 * LANES + lane, 0.0
            for k in range(3, 6):
                squares += nodes.twist[at + k * LANES] ** 2
            for k in range(3, 6):
                force = drag.value * (1.0 + squares**0.5) * nodes.inertia[at + k * LANES] * nodes.twist[at + k * LANES]
                nodes.wrench[at + k * LANES] -= force


@adds_wrench(Jet)
@kernel
def jet_wrench(jet, nodes):
    nodes.wrench[((nodes.packs - 1) * 6 + 4) * LANES + LANES - 1] += jet.value


@pytest.mark.parametrize(("parameters", "value"), [(Magnet, 5e-4), (Drag, 20.0), (Jet, 0.1)])
def test_gradient_through_an_own_effect(build, parameters, value):
    @register_effect(parameters.__name__.lower())
    class Own(Effect):
        """An effect of a user's own."""

        value: float

        def parameters(self, rod):
            return parameters(self.value)

    model = build("three_tendon", {f"effects.{parameters.__name__.lower()}.value": value})
    found = [gradient_accuracy(model, 0.02, LEAST, GREATEST, 0.05 * GREATEST, seed) for seed in range(2)]
    assert min(own.cosine for own in found) > 0.99
    assert max(abs(own.ratio - 1.0) for own in found) < 0.05
