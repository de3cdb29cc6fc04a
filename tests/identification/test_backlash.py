"""Backlash: what arrives of commands that turn back, and holds that know those before them."""

from dataclasses import replace

import numpy as np
import pytest

from soft_tendon_env.identification import MarkerSet
from soft_tendon_env.identification.backlash import after_play
from soft_tendon_env.identification.parameters import read_parameters
from soft_tendon_env.identification.readings import Plants, Readings
from soft_tendon_env.identification.recordings import Recording
from soft_tendon_env.model.build import build_model


def test_a_play_is_taken_up_before_anything_arrives():
    up_and_down = np.array([0.0, 0.3, 1.0, 2.0, 1.8, 1.4, 1.0, 1.3, 3.0])
    commands = np.column_stack([up_and_down, -up_and_down, up_and_down])
    arriving = after_play(commands, np.array([0.25, 0.25, 0.0]))
    expected = [0.0, 0.05, 0.75, 1.75, 1.75, 1.65, 1.25, 1.25, 2.75]
    np.testing.assert_allclose(arriving[:, 0], expected, atol=1e-12)
    expected_arriving = -np.array(expected)
    np.testing.assert_allclose(arriving[:, 1], expected_arriving, atol=1e-12)
    np.testing.assert_array_equal(arriving[:, 2], up_and_down)
    assert commands[1, 0] == 0.3  # the commands stay as they are


def test_a_cycle_encloses_the_area_of_a_rectangle_with_slanted_sides():
    """Of amplitude a and half-width w a play loses 4 w (a - w) in a whole cycle."""
    half_width = 0.2
    amplitude = 1.5
    phase = np.linspace(0.0, 4.0 * np.pi, 4001)
    cycle = amplitude * np.sin(phase)
    arriving = after_play(cycle[:, None], np.array([half_width]))[:, 0]
    second = slice(2000, 4001)
    area = np.trapezoid(cycle[second], arriving[second])
    expected = 4.0 * half_width * (amplitude - half_width)
    assert area == pytest.approx(expected, rel=1e-3)


@pytest.fixture(scope="module")
def plants(arm):
    driven = arm.replace(
        {"effects.tendon_elasticity": {"stiffness": 3e3, "displacement_limits": [-0.01, 0.03]}}
    )
    placed = MarkerSet.parse({"markers": {"tip": {"arc_length": 0.2}}}, "test")
    asked = ["commands.backlash", "commands.1.gain"]
    parameters = read_parameters(asked, driven, placed)
    model = build_model(driven)
    return Plants(driven, model, placed, parameters)


def test_backlash_is_one_for_all_tendons_and_a_share_of_their_range(plants):
    backlash, gain = plants.parameters
    assert (backlash.value, backlash.low, backlash.prior) == (0.0, 0.0, None)
    assert backlash.high == pytest.approx(0.05 * 0.04)
    x = np.array([backlash.coordinate(5e-4), gain.coordinate(1.2)])
    measurement = plants.measurement(x)
    np.testing.assert_allclose(measurement.backlash, 5e-4)
    np.testing.assert_allclose(measurement.gain, [1.0, 1.2, 1.0])


def test_a_hold_knows_the_commands_before_it_in_its_file(plants):
    millimetres = [[0.0, 0, 0], [4.0, 0, 0], [2.0, 1.0, 0], [2.0, 1.0, 0]]
    session = 1e-3 * np.array(millimetres)
    backlash, gain = plants.parameters
    x = np.array([backlash.coordinate(5e-4), gain.coordinate(1.5)])

    def arriving(rows, session):
        recordings = [
            Recording(f"{i}", "", session[i : i + 1], np.zeros((1, 1, 3)), 0.0, {}, "", session, i)
            for i in rows
        ]
        return [command[0] for _, command in Readings(plants, recordings)._arms(x)]

    pulled, released = arriving([1, 3], session)
    np.testing.assert_allclose(pulled, [3.5e-3, 0.0, 0.0], atol=1e-12)
    # a gain acts on what arrives
    np.testing.assert_allclose(released, [2.5e-3, 0.75e-3, 0.0], atol=1e-12)
    alone = replace(
        Recording("0", "", session[1:2], np.zeros((1, 1, 3)), 0.0, {}), command=session[1:2]
    )
    ((_, command),) = Readings(plants, [alone])._arms(x)
    np.testing.assert_allclose(command[0], session[1], atol=1e-12)


def test_without_backlash_commands_arrive_as_they_are(plants):
    commands = 1e-3 * np.array([[3.0, 0.0, 1.0]])
    hold = Recording("0", "", commands, np.zeros((1, 1, 3)), 0.0, {})
    ((_, command),) = Readings(plants, [hold])._arms(np.zeros(2))
    np.testing.assert_array_equal(command, commands)
