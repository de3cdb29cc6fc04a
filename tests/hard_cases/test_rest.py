"""Motions from rest: where `simulate` begins under loads, and what trials are made of."""

import numpy as np
import pytest

import soft_tendon_env as ste
from soft_tendon_env.accuracy.fidelity import at_fidelity

LOADED = {
    "two_segment_six": {
        "effects.gravity.acceleration": [2.0, -6.0, 5.0],
        "effects.tip_load.mass": 0.015,
    },
    "helical": {
        "effects.gravity.acceleration": [0.0, 0.0, 9.81],
        "effects.tip_load.force": [0.0, 0.03, 0.0],
    },
    "underwater": {"effects.fluid.current": [0.0, 0.2, -0.1]},
    "four_tendon": {
        "effects.disturbance.loads": [{"at": 0.25, "force": [0.0, 0.05, 0.0]}],
        "effects.tendon_friction.coefficient": 0.2,
    },
}


@pytest.mark.slow
def test_simulate_begins_at_rest_under_loads(tip_distance, measured):
    """Gravity, payloads, currents, steady forces: from the stress-free shape the arm falls, by far
    more than any accuracy that is stated. Expected: without tension nothing moves, to 1e-6 of the
    length, with tendon friction too; from the stress-free state the arm falls."""
    for name, changes in LOADED.items():
        scene = ste.load_scene(name).replace(changes)
        model = ste.build_model(at_fidelity(scene, "standard"))
        slack = np.zeros(model.tendon_count)
        motion = ste.simulate(model, slack, 1.0, 0.1)
        moved = tip_distance(motion.tip_pose, motion.tip_pose[:1]) / model.length
        fallen = (
            tip_distance(
                ste.simulate(model, slack, 1.0, 0.1, ste.Simulation(model).state).tip_pose,
                motion.tip_pose,
            )
            / model.length
        )
        measured("moved from rest, part of the length", moved)
        measured("fallen from the stress-free shape", fallen)
        assert moved < 1e-6, name
        assert fallen > 0.01, name
        start = ste.Simulation(model).reset_at_rest(slack + 1.0, time=0.5)
        held = ste.simulate(model, slack + 1.0, 0.1, 0.1, start).q
        assert start.time == 0.5
        difference = held - start.q
        assert np.abs(difference).max() < 1e-4 * np.abs(start.q).max()


@pytest.mark.slow
def test_an_arm_that_rests_nowhere(build):
    """Beck's column beyond its load: a force that follows the tip flutters, and there is nowhere to
    settle. Expected: NoEquilibriumError that says why and what to do, before anything is simulated;
    with an initial state it moves."""
    load = {"effects.tip_load": {"force": [-3.0, 0.0, 0.0], "frame": "tip"}}
    model = build(
        "three_tendon",
        {"strain.passive": [{"strains": ["bend_y", "bend_z"], "order": 2, "span": "rod"}], **load},
    )
    with pytest.raises(
        ValueError, match="duration should be a multiple"
    ):  # bad input is told before a rest is searched
        ste.simulate(model, np.zeros(3), 0.033, 0.02)
    with pytest.raises(
        ste.NoEquilibriumError, match="at rest nowhere under its loads .*Give an initial state"
    ):
        ste.simulate(model, np.zeros(3), 0.1, 0.02)
    assert np.isfinite(
        ste.simulate(model, np.zeros(3), 0.1, 0.02, ste.Simulation(model).state).q
    ).all()


def test_trials_leave_obstacles_out():
    """Reference motions that touch do not converge: a calibration stood still for a quarter of an
    hour. Expected: the same coordinates as without the obstacle, in seconds."""
    arm = ste.load_scene("three_tendon")
    plate = {
        "effects.contact.obstacles": [
            {"type": "plane", "position": [0.0, 0.0, -0.05], "axis": [0.0, 0.0, 1.0]}
        ]
    }
    assert at_fidelity(arm.replace(plate), "2mm").strain == at_fidelity(arm, "2mm").strain
