"""Presets: the shipped arms keep their quadrature, other arms get what they need, and the finer
preset the more."""

import warnings

import pytest

from soft_tendon_env.accuracy.fidelity import (
    PRESETS,
    FidelityWarning,
    accuracy_of,
    at_fidelity,
    build_model,
)
from soft_tendon_env.accuracy.input_motions import motion_tensions
from soft_tendon_env.accuracy.reference import distance, reference_motions, tip_path
from soft_tendon_env.scene.file import load_scene, scene_names
from soft_tendon_env.scene.scene import rod_length


@pytest.mark.parametrize("name", scene_names())
def test_presets_of_shipped_scenes(name):
    """Four intervals, four to six, under water one more, and at least eight; the finest preset with
    more of the arm's own fields than the coarsest; no warning."""
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        models = [build_model(load_scene(name), fidelity) for fidelity in PRESETS]
    counts = [model.grid.per_piece for model in models]
    assert counts[0] == 4
    assert 4 <= counts[1] <= (7 if name == "underwater" else 6)
    assert counts[2] >= 8
    fast, standard, fine = (model.scene.strain.passive.fields for model in models)
    assert 3 <= fast <= standard <= fine
    assert fast < fine


def test_what_a_scene_leaves_open_is_standard_and_what_it_says_stays():
    scene = load_scene("three_tendon")
    assert at_fidelity(scene, None) == at_fidelity(scene, "standard")
    moments = {"strain.passive": [{"strains": ["torsion"], "order": 1, "span": "rod"}]}
    for changes in (moments, {"quadrature.intervals": 9}, {"integrator.step": 0.01}):
        (part,) = {key.split(".")[0] for key in changes}
        changed = scene.replace(changes)
        kept = at_fidelity(changed, None)
        standard = at_fidelity(scene, "standard")
        for name in ("strain", "quadrature", "integrator"):
            assert getattr(kept, name) == getattr(changed if name == part else standard, name)
        assert at_fidelity(changed, "scene") == changed
        assert at_fidelity(changed, "standard") == standard


@pytest.mark.parametrize("name", ["paper", "four_tendon", "helical"])
def test_standard_is_near_full_physics_and_fast_not_far(name):
    """As shares of the length, on a motion that no field was made from."""
    scene = load_scene(name)
    tensions = motion_tensions(scene, "smooth", 11, 1.0)
    length = rod_length(scene)
    (exact,) = reference_motions(scene, [tensions], 5e-5 * length).tips
    for fidelity, asked in PRESETS.items():
        model = build_model(scene, fidelity)
        assert distance(tip_path(model, tensions), exact) < asked.share * length, fidelity


@pytest.mark.parametrize(
    ("change", "margin"),
    [({}, 1.0), ({"segments.0.young_modulus": 0.85}, 2.5), ({"segments.0.damping": 1.2}, 2.5)],
)
def test_shipped_errors_have_a_margin_for_an_arm_within_a_quarter(change, margin):
    """Its steps are finer, and its fields no fewer."""
    shipped = load_scene("paper")
    changed = shipped
    for key, factor in change.items():
        value = getattr(shipped.segments[0], key.split(".")[-1])
        changes = {key: factor * value}
        changed = changed.replace(changes)
    for preset in ("fast", "standard"):
        own = at_fidelity(shipped, preset)
        alike = at_fidelity(changed, preset)
        expected_tolerance = margin * alike.integrator.tolerance
        assert own.integrator.tolerance == pytest.approx(expected_tolerance)
        assert alike.strain.passive.fields >= own.strain.passive.fields


@pytest.fixture(scope="module")
def softer_arm():
    """An arm within a quarter of the paper's, tensions of a motion, and its converged tip."""
    shipped = load_scene("paper")
    segment = shipped.segments[0]
    _, high = shipped.tendons[0].tension_limits
    softer = shipped.replace(
        {
            "segments.*.young_modulus": 0.82 * segment.young_modulus,
            "segments.*.damping": 0.83 * segment.damping,
            "tendons.*.tension_limits": [0.0, 1.2 * high],
        }
    )
    tensions = motion_tensions(softer, "redrawn", 12, 0.8)
    (exact,) = reference_motions(softer, [tensions], 5e-5 * rod_length(softer)).tips
    return softer, tensions, exact


@pytest.mark.parametrize("preset", ["fast", "standard"])
def test_a_softer_arm_within_a_quarter_keeps_its_preset(softer_arm, preset):
    """It is pulled harder too, and less damped."""
    softer, tensions, exact = softer_arm
    model = build_model(softer, preset)
    allowed = 0.8 * PRESETS[preset].share * rod_length(softer)
    assert distance(tip_path(model, tensions), exact) < allowed


def test_a_fidelity_that_nobody_said_is_told_where_it_matters():
    """Of a scene that leaves its strain open a model has other coordinates than `gym.make`."""
    with pytest.warns(
        FidelityWarning, match="'paper' leaves its strain open.*fidelity='standard'"
    ) as caught:
        left_out = build_model(load_scene("paper"))
    assert caught[0].filename == __file__
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        scene = load_scene("paper")
        assert left_out.scene == build_model(scene, "scene").scene
        build_model(load_scene("paper_16dof"))


def test_a_length_is_an_accuracy_and_others_are_refused():
    scene = load_scene("three_tendon")
    for length, share, near in (
        ("6mm", 0.02, "fast"),
        ("0.6mm", 2e-3, "standard"),
        ("0.06mm", 2e-4, "fine"),
    ):
        asked = accuracy_of(scene, length)
        preset = PRESETS[near]
        assert asked.share == pytest.approx(share)
        assert asked.least == preset.least
        expected_tolerance = preset.tolerance * min(share / preset.share, 1.0)
        assert asked.tolerance == pytest.approx(expected_tolerance)
    for name in ("quick", "", "Standard", "1 inch", "0mm", "-1mm"):
        with pytest.raises(ValueError, match=f"fidelity is '{name}': should be"):
            build_model(scene, name)
