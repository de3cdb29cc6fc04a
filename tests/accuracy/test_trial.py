"""Trials: what is chosen keeps its error on other motions and loads, is found once, and says so
where nothing does."""

import json

import numpy as np
import pytest

from soft_tendon_env.accuracy import trial as module
from soft_tendon_env.accuracy.fidelity import PRESETS, accuracy_of, at_fidelity
from soft_tendon_env.accuracy.input_motions import USUAL, motion_tensions
from soft_tendon_env.accuracy.reference import distance, reference_motions, tip_path
from soft_tendon_env.accuracy.trial import (
    Choice,
    Trial,
    bare_rod,
    choose,
    settle,
    strain_tables,
    trial_digest,
)
from soft_tendon_env.compiler.kept_code import cache_folder
from soft_tendon_env.model.build import build_model
from soft_tendon_env.scene.file import load_scene
from soft_tendon_env.scene.passive_fields import FidelityWarning, find_fields
from soft_tendon_env.scene.scene import rod_length
from soft_tendon_env.tools import files
from soft_tendon_env.tools.configuration import ConfigurationError

SHIPPED = load_scene("three_tendon")
ARM = SHIPPED.replace(
    {
        "segments.0.length": 0.2,
        "segments.0.radius": 0.011,
        "effects.gravity.acceleration": [0.0, 0.0, -9.81],
    }
)
SPRING = {
    "segments.0.curvature": [6.2, 0.0, 30.8],
    "segments.0.length": 0.6,
    "segments.0.young_modulus": 2e7,
    "segments.0.radius": 0.004,
}
STOCKY = {
    "segments.0.length": 0.3,
    "segments.0.radius": 0.025,
    "effects.tip_load.force": [0.0, 3.0, -4.0],
}
TWO = {"segments.0.length": 0.25, "tendons.0.end": 0.11, "segments.0.curvature": [0.0, 4.0, 2.0]}


@pytest.fixture(autouse=True)
def cache(tmp_path, monkeypatch):
    """The folder of trials in a cache of its own."""
    cache_folder()  # of kernels, which stays as it is
    monkeypatch.setattr(files, "cache_parents", lambda: [tmp_path])
    return tmp_path / "soft_tendon_env" / "trials"


@pytest.mark.slow
@pytest.mark.parametrize("changes", [SPRING, STOCKY, TWO], ids=["spring", "stocky", "two pieces"])
def test_presets_keep_their_error_at_rest_and_in_motion(changes):
    """None above 1.5 times what it says, on tensions that the trial had not; the finer the preset
    the smaller the error."""
    scene, errors = ARM.replace(changes), []
    limits = np.array([tendon.tension_limits for tendon in scene.tendons]).T
    inputs = [
        *np.random.default_rng(7).uniform(*limits, (8, 3)),
        *(motion_tensions(scene, kind, 70, 1.5) for kind in USUAL),
    ]
    exact = reference_motions(scene, inputs, 2e-5 * rod_length(scene)).tips
    for preset in PRESETS:
        model = build_model(at_fidelity(scene, preset))
        errors.append(
            max(
                distance(tip_path(model, tensions), tips)
                for tensions, tips in zip(inputs, exact, strict=True)
            )
            / rod_length(scene)
        )
        assert errors[-1] <= 1.5 * PRESETS[preset].share, preset
    assert errors[2] < errors[0]


def test_it_is_made_once_and_kept(cache, monkeypatch):
    monkeypatch.setattr(module, "SECONDS", 0.2)
    found = choose(ARM, PRESETS["fast"])
    assert (
        found.error < PRESETS["fast"].share / module.MARGIN
        and found.coordinates == build_model(found.of(ARM)).coordinate_count
    )
    (path,) = cache.glob("*.json")
    monkeypatch.setattr(module, "search", lambda scene, asked: found._replace(coordinates=99))
    assert choose(ARM, PRESETS["fast"]) == found
    path.write_bytes(path.read_bytes()[:-9])
    assert (
        choose(ARM, PRESETS["fast"]).coordinates == 99
        and json.loads(path.read_text())["coordinates"] == 99
    )
    cannot = lambda name: (_ for _ in ()).throw(OSError(30, "read-only"))  # noqa: E731
    monkeypatch.setattr(module, "new_data_folder", cannot)
    assert choose(ARM, PRESETS["fine"]).coordinates == 99


@pytest.mark.parametrize(
    "change, same",
    [
        (
            {
                "name": "other",
                "quadrature.intervals": 9,
                "integrator.step": 0.01,
                "strain.passive": [],
                "effects.actuators.time_constant": 0.1,
            },
            True,
        ),
        (
            {
                "effects.contact.obstacles": [
                    {"type": "plane", "position": [0.0, 0.0, -0.5], "axis": [0.0, 0.0, 1.0]}
                ]
            },
            True,
        ),
        ({"segments.0.density": 1100.0}, False),
        ({"tendons.0.tension_limits": [0.0, 1.0]}, False),
        ({"effects.gravity.acceleration": [0.0, 0.0, 9.81]}, False),
        ({"strain": {"type": "statics_based", "strains": ["bend_y", "bend_z"]}}, False),
    ],
)
def test_another_arm_load_or_accuracy_is_another_trial(change, same):
    fast = PRESETS["fast"]
    assert (trial_digest(ARM.replace(change), fast) == trial_digest(ARM, fast)) == same
    assert trial_digest(ARM, fast) != trial_digest(ARM, PRESETS["fine"])


def test_where_nothing_reaches_it_a_preset_warns_and_a_length_is_refused(monkeypatch):
    best = Choice(bare_rod(ARM), {"least": 6}, {"tolerance": 1e-5}, 3, 0.012)
    monkeypatch.setattr(module, "search", lambda scene, asked: best)
    with pytest.warns(
        FidelityWarning,
        match=r"as 'fast' asks, 1 % of the length.*3 coordinates, were within 1.2 %",
    ):
        at_fidelity(ARM, "fast")
    with pytest.raises(ConfigurationError, match=r"as '1mm' asks, 0.5 %"):
        at_fidelity(ARM, "1mm")
    assert at_fidelity(ARM, "4mm").strain.passive == ()
    monkeypatch.setattr(module, "search", lambda scene, asked: best._replace(error=np.inf))
    with pytest.warns(FidelityWarning, match="is not known: full physics has no motion"):
        at_fidelity(ARM.replace({"segments.0.density": 700.0}), "fast")


def test_fields_of_the_arms_own_need_no_trial_and_others_are_tried(monkeypatch):
    monkeypatch.setattr(module, "choose", None)
    fields = find_fields(SHIPPED)
    assert at_fidelity(SHIPPED, "fast").strain.passive.digest == fields.digest
    softer = SHIPPED.replace({"segments.0.young_modulus": 0.6 * SHIPPED.segments[0].young_modulus})
    tables = strain_tables(softer, find_fields(softer))
    assert {"type": "snapshots", "fields": 6, "digest": fields.digest} in [
        table.get("passive") for table in tables
    ]


def test_strains_and_loads_of_the_rod_stay():
    kirchhoff = ARM.replace(
        {
            "strain": {
                "type": "statics_based",
                "strains": ["bend_y", "bend_z"],
                "include_loads": True,
            }
        }
    )
    tables = [
        kirchhoff.replace({"strain": table}).strain for table in strain_tables(kirchhoff, None)
    ]
    assert all({*strain.free} == {"bend_y", "bend_z"} for strain in tables)
    assert all(strain.include_loads for strain in tables if strain.type == "statics_based")


def test_quadrature_and_steps_are_settled(monkeypatch):
    monkeypatch.setattr(module, "SECONDS", 0.2)
    curled = ARM.replace({"segments.0.curvature": [0.0, 0.0, 70.0]})
    trial = Trial(curled, 2e-3)
    found = settle(trial, accuracy_of(curled, "standard"))
    assert found.quadrature["least"] > PRESETS["standard"].least
    assert trial.agree(found, found.finer(3.0), 1, 0.5) and trial.agree(
        found, found.finer(1.0, 10.0), 2, 0.5
    )


def test_what_full_physics_is_unsure_of_counts_or_is_left_out(monkeypatch):
    still = np.zeros(3)
    path = tip_path(build_model(ARM), still)
    for error, bound, left_out in ((1e-7, 1e-7, 0), (1e-4, 1e-4, 0), (1.0, None, 17)):
        made = type("Made", (), {"tips": (path,) * 17, "tip_errors": (error,) * 17})
        monkeypatch.setattr(module, "reference_motions", lambda *_, made=made: made)
        monkeypatch.setattr(module, "USUAL", ())
        trial = Trial(ARM, 2e-3)
        assert trial.left_out == left_out
        if bound:
            trial.tests = trial.tests[:1]
            assert trial.distance(build_model(ARM)) == pytest.approx(bound)
    found = Choice(bare_rod(ARM), {"least": 6}, {"tolerance": 1e-5}, 3, 0.012, 17)
    assert "without 17 inputs under which the arm's motion is not unique" in found.describe(ARM)
