"""Pareto fronts, the settings on them, what measures them, and converged references; test inputs: bands and the same seed again."""

import numpy as np
import pytest

from soft_tendon_env.accuracy.input_motions import HOLD, MOTIONS, motion_tensions
from soft_tendon_env.accuracy.pareto import Setting, evaluation_cost, explore, measure, pareto_front, strain_fields, worst
from soft_tendon_env.accuracy.reference import LEVELS, Reference, full_physics, reference_motions, trajectory
from soft_tendon_env.model.build import build_model
from soft_tendon_env.model.model import model_on
from soft_tendon_env.scene.file import load_scene

ARM, PAPER = load_scene("three_tendon"), load_scene("paper")
GREATEST = {"redrawn": 15.0, "increments": 20.0, "smooth": 20.0, "wild": 60.0, "step": 20.0, "noisy": 24.0}


@pytest.fixture(scope="module")
def inputs():
    return [motion_tensions(ARM, "redrawn", seed, 0.2) for seed in (1, 2)]


@pytest.fixture(scope="module")
def points(inputs):
    return explore(ARM, inputs, reference_motions(ARM, inputs, 1e-4), None)


def test_a_front_has_what_nothing_beats_in_both():
    items = [(1.0, 5.0), (2.0, 7.0), (3.0, 2.0), (3.0, 3.0), (4.0, 2.0), (5.0, np.inf), (6.0, 1.0)]
    assert pareto_front(items, lambda item: item) == [(1.0, 5.0), (3.0, 2.0), (6.0, 1.0)]
    assert worst((1.0, np.nan, 2.0)) == 2.0 and worst((np.nan, np.inf)) == np.inf and worst((np.nan,)) == np.inf


def test_more_cost_buys_less_error_and_every_setting_is_a_scene(points):
    errors = [point.tip_error for point in pareto_front(points, lambda point: (point.cost, point.tip_error))]
    assert len(errors) > 3 and errors == sorted(errors, reverse=True) and errors[0] > 30.0 * errors[-1]
    for point in points[::5]:
        model = build_model(point.setting.of(ARM))
        assert model.coordinate_count == point.coordinates and model.grid.per_piece == point.setting.intervals
        assert point.cost == pytest.approx(point.evaluations * evaluation_cost(model))


def test_errors_are_distances_from_the_reference(inputs):
    """A motion that the model has not counts as infinitely far, one that full physics has not does not count."""
    model, setting = full_physics(ARM, LEVELS[0]), Setting("", {}, 12, 1e-5)
    path = trajectory(model, inputs[0]).tip_pose[:, :3, 3]
    found = measure(model, setting, [inputs[0]] * 2, Reference((path, path + [0.0, 0.0018, 0.0024]), (0.0, 0.0), LEVELS[0]))
    assert found.tip_errors == (0.0, pytest.approx(0.003))
    assert found.evaluations == 700.0, "4 columns take 7 evaluations every 10 ms"
    stuck, beyond = model_on(ARM.replace({"integrator.max_halvings": 0}), 8), np.full_like(inputs[0], 1e5)
    found = measure(stuck, setting, [beyond, beyond], Reference((path, None), (0.0, 0.0), LEVELS[0]))
    assert found.tip_errors[0] == np.inf and np.isnan(found.tip_errors[1]) and found.tip_error == np.inf


def test_strain_fields_keep_the_strains_and_the_loads_of_the_rod():
    rod = {"type": "statics_based", "strains": ["bend_y", "bend_z"], "include_loads": True}
    kirchhoff = ARM.replace({"strain": rod, "effects.gravity.acceleration": [0.0, 0.0, -9.81]})
    for table in strain_fields(kirchhoff, None).values():
        strain = kirchhoff.replace({"strain": table}).strain
        assert set(strain.free) == {"bend_y", "bend_z"} and strain.include_loads


def test_the_error_bar_bounds_the_error():
    motions = [motion_tensions(ARM, kind, 0, 0.5) for kind in ("redrawn", "smooth")]
    rough, fine = (reference_motions(ARM, motions, tolerance) for tolerance in (1e-3, 1e-8))
    assert LEVELS.index(rough.level) < LEVELS.index(fine.level)
    for before, after, bar in zip(rough.tips, fine.tips, rough.tip_errors, strict=True):
        assert before.shape == (0.5 / HOLD + 1, 3) and 0.0 < np.linalg.norm(after - before, axis=1).max() <= 1.05 * bar
    assert max(fine.tip_errors) < 1e-6


@pytest.mark.cases("motion", MOTIONS)
def test_tensions_fill_their_band_and_are_those_of_their_seed(motion):
    tables = np.concatenate([motion_tensions(PAPER, motion, seed) for seed in range(20)])
    assert tables.shape == (20 * 2.0 / HOLD, 10)
    assert tables.min() >= 0.0 and 0.9 * GREATEST[motion] < tables.max() <= GREATEST[motion]
    np.testing.assert_array_equal(motion_tensions(PAPER, motion, 3), motion_tensions(PAPER, motion, 3))
    assert np.abs(motion_tensions(PAPER, motion, 3) - motion_tensions(PAPER, motion, 4)).max() > 1.0
