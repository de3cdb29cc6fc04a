"""Loads and motions that change faster than integrator steps of 20 ms."""

import math
import warnings

import numpy as np
import pytest

import soft_tendon_env as ste
from soft_tendon_env.accuracy.fidelity import at_fidelity
from soft_tendon_env.effects import (
    LANES,
    Effect,
    Struct,
    adds_wrench,
    allow_turning,
    kernel,
    limits_step,
)
from soft_tendon_env.model.step_control import CommandWarning

DURATION = 0.21  # [s]
SAMPLES = 0.014  # between samples [s]
FIDELITIES = (
    "scene",
    "standard",
    *(pytest.param(preset, marks=pytest.mark.slow) for preset in ("fast", "fine")),
)


def wrong_share(scene, fidelity):
    """Largest distance of the tip to that of steps a hundredth of a period long, over its
    motion."""
    *_, frequency = scene
    base = ste.load_scene("two_segment_six").replace(scene[0])
    usual = at_fidelity(base, fidelity)
    changes = {"integrator": {"step": min(1e-3, 0.01 / frequency), "columns": 3}}
    fine = usual.replace(changes)
    found, exact = (
        ste.simulate(ste.build_model(each), np.zeros(6), DURATION, SAMPLES).tip_pose[:, :3, 3]
        for each in (usual, fine)
    )
    return (
        np.linalg.norm(found - exact, axis=1).max() / np.linalg.norm(exact - exact[0], axis=1).max()
    )


def sine(frequency):
    signal = {"type": "sine", "frequency": frequency, "phase": 90.0}
    return {
        "effects.disturbance.loads": [{"at": 0.3, "force": [0.0, 0.05, 0.02], "signal": signal}]
    }, frequency


def swing(frequency):
    size = 1e-3 * min(1.0, 30.0 / frequency)  # a base begins at its greatest speed
    return {
        "effects.moving_base": {"amplitude": [0.0, size, size], "frequency": frequency}
    }, frequency


def rock(frequency):
    size = 0.05 * min(1.0, 5.0 / frequency)
    return {
        "effects.moving_base": {
            "axis": [0.0, 0.6, 0.8],
            "angular_amplitude": size,
            "frequency": frequency,
        }
    }, frequency


SWINGS = [*map(sine, (2.0, 9.0, 150.0, 1000.0)), *map(swing, (13.0, 400.0)), rock(200.0)]


# presets say how long their motions are certain: less than 2 s here, and these last 0.21 s
@pytest.mark.filterwarnings("ignore:.*only in a trial")
@pytest.mark.parametrize(
    "cases",
    [[sine(50.0), swing(50.0)], pytest.param(SWINGS, marks=pytest.mark.slow)],
    ids=["50 Hz", "others"],
)
@pytest.mark.parametrize("fidelity", FIDELITIES)
def test_periods_that_fit_into_a_step(fidelity, cases, measured):
    """Forces and bases that swing and rock at 2 to 1000 Hz, 50 Hz and its multiples among them:
    every evaluation of steps of 20 ms sees the same phase. Expected: the tip within 5 % of its
    motion of steps a hundredth of a period long."""
    shares = [wrong_share(case, fidelity) for case in cases]
    measured("part of the motion", max(shares))
    assert max(shares) < 0.05, shares


@pytest.mark.parametrize("fidelity", ["scene", "standard"])
def test_pulse_shorter_than_a_step(fidelity, measured):
    """A push of 1 ms between two evaluations of a step of 20 ms. Expected: the arm moves as with
    steps of 0.1 ms, to 2 %."""
    push = {
        "at": 0.3,
        "force": [0.0, 2.0, 0.0],
        "signal": {"type": "pulse", "start": 0.0231, "duration": 1e-3},
    }
    share = wrong_share(({"effects.disturbance.loads": [push]}, 100.0), fidelity)
    measured("part of the motion", share)
    assert share < 0.02


def test_tension_that_swings_within_steps(measured):
    """A tension that is a function of time is held over steps at its value in their middle: one of
    50 Hz is a constant at 20 ms. Expected: a warning that says by how much, and none for what the
    steps follow."""
    scene = ste.load_scene("three_tendon")
    model = ste.build_model(scene)
    for frequency, told in ((50.0, True), (100.0, True), (23.0, True), (0.5, False), (3.0, False)):
        for phase in (0.0, 0.5 * np.pi):
            with warnings.catch_warnings(record=True) as caught:
                warnings.simplefilter("always")
                ste.simulate(
                    model,
                    lambda t, f=frequency, p=phase: [
                        1.0 + np.sin(2.0 * np.pi * f * t + p),
                        0.0,
                        0.0,
                    ],
                    0.4,
                    0.02,
                )
            assert (
                any(issubclass(warning.category, CommandWarning) for warning in caught) == told
            ), frequency
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        ste.simulate(model, lambda t: [2.0 * (t > 0.1), 0.0, 0.0], 0.4, 0.02)


@pytest.mark.parametrize("fidelity", ["scene", pytest.param("standard", marks=pytest.mark.slow)])
def test_actuators_that_arrive_within_a_step(fidelity, measured):
    """Commands redrawn every 20 ms, which actuators of limited rate or short lag reach within the
    step: a kink that no estimate of the error sees. Expected: the tip within 5 % of its motion of
    steps of 0.2 ms."""
    base = ste.load_scene("two_segment_six")
    rng = np.random.default_rng(5)
    commands = rng.uniform(0.0, 4.0, (25, 6))
    shares = []
    for actuators in (
        {"rate_limit": 300.0},
        {"rate_limit": 60.0},
        {"time_constant": 2e-3},
        {"rate_limit": 150.0, "time_constant": 4e-3},
    ):
        usual = at_fidelity(base.replace({"effects.actuators": actuators}), fidelity)
        changes = {"integrator": {"step": 2e-4, "columns": 3}}
        fine = usual.replace(changes)
        found, exact = (
            ste.simulate(ste.build_model(each), commands, 0.5, 0.02).tip_pose[:, :3, 3]
            for each in (usual, fine)
        )
        shares.append(
            np.linalg.norm(found - exact, axis=1).max()
            / np.linalg.norm(exact - exact[0], axis=1).max()
        )
    measured("part of the motion", max(shares))
    assert max(shares) < 0.05, shares


class Shaking(Struct):
    frequency: float  # [Hz]


class ShakingUnlimited(Struct):
    frequency: float


@kernel
def shake(shaking, nodes):
    """A force on the last node along z."""
    nodes.wrench[nodes.packs * 6 * LANES - 1] += 0.05 * math.cos(
        2.0 * math.pi * shaking.frequency * nodes.time
    )


@pytest.fixture
def shaker(forgotten):
    """Registers an effect of a user's own, with the parameters of a class."""

    def add_shaker(kind):
        adds_wrench(kind)(shake)

        @ste.register("effect", "shaker")
        class Shaker(Effect):
            frequency: float

            def parameters(self, rod):
                return kind(self.frequency)

    return add_shaker


@pytest.mark.slow
def test_an_effect_of_a_users_own_that_reads_the_time(shaker, measured):
    """A kernel of a user's own swings at 100 Hz. Expected: a warning where it says nothing of that,
    and where it limits the steps none, and the tip within 5 % of its motion of steps a hundredth of
    a period long."""
    shaker(ShakingUnlimited)
    with pytest.warns(UserWarning, match="ShakingUnlimited reads the time.*@limits_step"):
        ste.build_model(
            ste.load_scene("two_segment_six").replace({"effects.shaker.frequency": 100.0}), "scene"
        )

    @limits_step(Shaking)
    @kernel
    def limit(shaking, nodes, longest):
        allow_turning(2.0 * math.pi * shaking.frequency, longest)

    shaker(Shaking)
    with warnings.catch_warnings():
        warnings.filterwarnings("error", message=".*reads the time")
        share = wrong_share(({"effects.shaker.frequency": 100.0}, 100.0), "scene")
    measured("part of the motion", share)
    assert share < 0.05
