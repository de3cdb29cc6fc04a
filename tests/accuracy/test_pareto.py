"""Pareto fronts, the settings on them and what measures them."""

import numpy as np
import pytest

from soft_tendon_env.accuracy import pareto
from soft_tendon_env.accuracy.pareto import cpu_time, evaluation_rate, explore, measure, pareto_front, worst
from soft_tendon_env.accuracy.reference import LEVELS, Reference, backbones, full_physics, motion, reference_motions, trajectory
from soft_tendon_env.accuracy.settings import Setting, evaluation_cost, integrators, quadratures, strain_fields
from soft_tendon_env.accuracy.test_inputs import motion_tensions
from soft_tendon_env.mechanics.algebra.lanes import LANES
from soft_tendon_env.model.build import build_model
from soft_tendon_env.model.model import model_on
from soft_tendon_env.scene.file import load_scene

ARM = load_scene("three_tendon")


@pytest.fixture(scope="module")
def inputs():
    return [motion_tensions(ARM, "redrawn", seed, 0.2) for seed in (1, 2)]


@pytest.fixture(scope="module")
def points(inputs):
    return explore(ARM, inputs, reference_motions(ARM, inputs, 1e-4), None)


def test_a_front_has_what_nothing_beats_in_both():
    items = [(1.0, 5.0), (2.0, 7.0), (3.0, 2.0), (3.0, 3.0), (4.0, 2.0), (5.0, np.inf), (6.0, 1.0)]
    assert pareto_front(items, lambda item: item) == [(1.0, 5.0), (3.0, 2.0), (6.0, 1.0)]
    assert (2.0, 7.0) in pareto_front(items, lambda item: item, slack=1.5)


def test_the_worst_error_leaves_out_motions_that_full_physics_has_not():
    assert worst((1.0, np.nan, 2.0)) == 2.0 and worst((np.nan, np.inf)) == np.inf and worst((np.nan,)) == np.inf


def test_more_cost_buys_less_error(points):
    front = pareto_front(points, lambda point: (point.cost, point.tip_error))
    errors = [point.tip_error for point in front]
    assert len(front) > 3 and errors == sorted(errors, reverse=True) and errors[0] > 30.0 * errors[-1]
    assert all(point.backbone_error >= point.tip_error for point in front)


def test_every_setting_is_a_scene_that_builds_as_it_was_measured(points):
    for point in points[::5]:
        model = build_model(point.setting.of(ARM))
        assert model.coordinate_count == point.coordinates and model.grid.per_piece == point.setting.intervals
        assert point.cost == pytest.approx(point.evaluations * evaluation_cost(model))


def test_errors_are_distances_from_the_reference(inputs):
    model = full_physics(ARM, LEVELS[0])
    own = backbones(model, motion(model, inputs[0]))
    moved = own + np.linspace(0.0, 0.003, 10)[:, None] * [0.0, 0.6, 0.8]
    reference = Reference((own, moved), (0.0, 0.0), (0.0, 0.0), LEVELS[0])
    setting = Setting("", {}, 12, 0.01, 4, None)
    found = measure(model, setting, [inputs[0], inputs[0]], reference)
    assert found.tip_errors == (0.0, pytest.approx(0.003)) and found.backbone_errors == (0.0, pytest.approx(0.003))
    assert found.evaluations == 700.0, "4 columns take 7 evaluations every 10 ms"


def test_a_motion_that_the_model_has_not_counts_as_infinitely_far(inputs):
    model = full_physics(ARM, LEVELS[0])
    own = backbones(model, motion(model, inputs[0]))
    beyond = np.full_like(inputs[0], 1e5)
    stuck = model_on(ARM.replace({"integrator.max_halvings": 0}), 8)
    found = measure(stuck, Setting("", {}, 8, 0.02, 3, None), [beyond, beyond], Reference((own, None), (0.0, 0.0), (0.0, 0.0), LEVELS[0]))
    assert found.tip_errors[0] == np.inf and np.isnan(found.tip_errors[1]) and found.tip_error == np.inf


def test_packs_are_full():
    assert [count * 1 for count in quadratures(ARM, 3)][:3] == [LANES, 2 * LANES, 3 * LANES]
    assert quadratures(ARM, 500)[0] >= 500
    paper = quadratures(load_scene("paper"), 4)
    assert paper[0] == 4 and all(2 * count % LANES == 0 for count in paper)


def test_few_columns_where_the_damping_allows_no_more():
    fixed = {columns for _, columns, tolerance in integrators(ARM) if tolerance is None}
    undamped = ARM.replace({"segments.0.damping": 0.0})
    assert fixed == {2, 3, 4} and {columns for _, columns, tolerance in integrators(undamped) if tolerance is None} == {2}


def test_strain_fields_keep_the_strains_that_the_rod_has():
    kirchhoff = ARM.replace({"strain": {"type": "statics_based", "strains": ["bend_y", "bend_z"]}})
    for table in strain_fields(kirchhoff, None).values():
        scene = kirchhoff.replace({"strain": table})
        assert set(scene.strain.free) == {"bend_y", "bend_z"}


@pytest.mark.slow
def test_the_cost_model_ranks_models_as_measured_times_do(build, monkeypatch):
    """But for a factor, and what machines differ by: kernels that have become faster in one part only show here."""
    monkeypatch.setattr(pareto, "REPEATS", 10)  # beside other processes, which lengthen single times
    fields = {"strain.passive": {"type": "snapshots", "fields": 18}}
    inside = {"effects.gravity.acceleration": [0.0, 0.0, -9.81], "strain.include_loads": True}
    cases = [("three_tendon", {}, 4), ("paper", fields, 12), ("paper_48dof", {}, 8), ("three_tendon", inside, 8)]
    ratios = []
    for name, changes, intervals in cases:
        model = build(name, {**changes, "quadrature.intervals": intervals, "integrator": {"columns": 3, "step": 0.02}})
        tables = [motion_tensions(model.scene, "redrawn", 0, 1.0)]
        evaluations = evaluation_rate([trajectory(model, tensions) for tensions in tables])
        ratios.append(evaluations * evaluation_cost(model) / cpu_time(model, tables))
    assert max(ratios) < 2.5 * min(ratios), ratios


def test_loads_inside_of_the_strain_have_their_price_and_stay_as_they_are(build):
    gravity = {"effects.gravity.acceleration": [0.0, 0.0, -9.81]}
    changes = ({**gravity, "strain.include_loads": True}, gravity)
    models = [build("three_tendon", {**own, "quadrature.intervals": 6}) for own in changes]
    inside, outside = (evaluation_cost(model) for model in models)
    assert inside > 1.5 * outside
    for model in models:
        tables = [table for table in strain_fields(model.scene, None).values() if table["type"] == "statics_based"]
        kept = [model.scene.replace({"strain": table}).strain.include_loads for table in tables]
        assert kept and all(own == model.scene.strain.include_loads for own in kept)
