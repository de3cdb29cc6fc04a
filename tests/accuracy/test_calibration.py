"""Calibrations: the cheapest setting within a tolerance, holds on other motions, is the same each time, made once."""

import shutil

import numpy as np
import pytest

from soft_tendon_env.accuracy import calibration as module
from soft_tendon_env.accuracy.calibration import MARGIN, Calibration, calibrate, calibrated, calibration_digest, cheapest_point
from soft_tendon_env.accuracy.input_motions import motion_tensions
from soft_tendon_env.accuracy.pareto import Point, Setting, measure
from soft_tendon_env.accuracy.reference import LEVELS, Reference, reference_motions
from soft_tendon_env.model.build import build_model
from soft_tendon_env.scene.file import load_scene
from soft_tendon_env.scene.passive_fields import PassiveFields, arm_of
from soft_tendon_env.scene.scene import breakpoints
from soft_tendon_env.tools import files
from soft_tendon_env.tools.configuration import ConfigurationError

ARM = load_scene("three_tendon")
KINDS = ("redrawn", "increments")
SECONDS = 0.2
FINE = 8e-4


def short(scene, seeds=range(3)):
    return [motion_tensions(scene, kind, seed, SECONDS) for kind in KINDS for seed in seeds]


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    """A user's cache with a calibration of ARM on short motions, without passive fields of its own."""
    folder = tmp_path_factory.mktemp("made")
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(files, "cache_parents", lambda: [folder])
        calibrate(ARM, short(ARM), None)
    return folder


@pytest.fixture(autouse=True)
def cache(made, tmp_path, monkeypatch):
    """The folder of calibrations in a copy of that cache, and short motions."""
    shutil.copytree(made, tmp_path, dirs_exist_ok=True)
    monkeypatch.setattr(files, "cache_parents", lambda: [tmp_path])
    monkeypatch.setattr(module, "usual_inputs", short)
    monkeypatch.setattr(module, "ensure_fields", lambda scene: None)
    return tmp_path / "soft_tendon_env" / "calibrations"


def point(name, error, cost):
    return Point(Setting(name, {"type": "statics_based"}, 4, 1e-5), 3, (error / 2, error), 200.0, cost)


def example(*points, bars=(0.0, 0.0)):
    return Calibration(tuple(points), Reference((np.zeros((2, 3)),) * 2, bars, LEVELS[1]))


def test_the_cheapest_within_the_tolerance_is_chosen():
    dear, good, cheap = point("dear", 1e-4, 3.0), point("good", 5e-4, 2.0), point("cheap", 2e-3, 1.0)
    found = example(dear, cheap, good)
    for tolerance, best in ((1e-3, good), (MARGIN * 5.01e-4, good), (MARGIN * 4.99e-4, dear)):
        assert cheapest_point(ARM, found, tolerance) is best
    assert [point.setting.name for point in found.front] == ["cheap", "good", "dear"]
    assert example(good, bars=(0.0, 1e-4)).within(good) == pytest.approx(MARGIN * 6e-4)
    with pytest.raises(ConfigurationError, match="no setting keeps the tip of 'three_tendon' within 0.01mm .* keeps within 0.2mm"):
        cheapest_point(ARM, found, 1e-5)


def test_the_setting_holds_on_motions_that_it_was_not_calibrated_on():
    scene, inputs = calibrated(ARM, FINE), short(ARM, range(100, 108))
    errors = measure(build_model(scene), Setting("", {}, 0, 0.0), inputs, reference_motions(ARM, inputs, 0.02 * FINE)).tip_errors
    assert max(errors) <= FINE and scene.segments == ARM.segments and scene.name == ARM.name


def test_it_is_the_same_when_made_anew(cache, monkeypatch):
    kept = calibrate(ARM, short(ARM), None)
    (file,) = cache.glob("*.json")
    file.write_bytes(file.read_bytes()[:-1000])
    again = calibrate(ARM, short(ARM), None)
    assert again.points == kept.points
    np.testing.assert_array_equal(again.reference.tips, kept.reference.tips)
    assert [path.suffix for path in cache.iterdir() if path.suffix != ".lock"] == [".json"]
    monkeypatch.setattr(module, "reference_motions", None)  # a further call simulates nothing
    assert calibrate(ARM, short(ARM), None).points == kept.points


@pytest.mark.cases(
    "change",
    [
        {"segments.0.density": 1100.0},
        {"effects.gravity.acceleration": [0.0, 0.0, -9.81]},
        {"strain": {"type": "statics_based", "strains": ["bend_y", "bend_z"]}},
    ],
)
def test_another_arm_or_load_is_another_calibration(change):
    inputs = short(ARM)
    assert calibration_digest(ARM.replace(change), inputs, None) != calibration_digest(ARM, inputs, None)
    other = ARM.replace({"quadrature.intervals": 9, "integrator.step": 0.01, "strain.passive": [], "name": "other"})
    assert calibration_digest(other, inputs, None) == calibration_digest(ARM, inputs, None) != calibration_digest(ARM, inputs[1:], None)


def test_fields_of_the_arms_own_are_made_once_and_kept(cache, monkeypatch):
    monkeypatch.undo()
    monkeypatch.setattr(files, "cache_parents", lambda: [cache.parents[1]])
    arm = ARM.replace({"segments.0.length": 0.123})
    coefficients = np.zeros((2, 1, 6, 11))
    coefficients[0, 0, 1, 0] = coefficients[1, 0, 2, 0] = 1.0
    limits = np.array([tendon.tension_limits for tendon in arm.tendons])
    fields = PassiveFields(arm_of(arm), limits, breakpoints(arm), coefficients, arm.effects, np.ones(2), {})
    made = []
    monkeypatch.setattr(module, "make_passive_fields", lambda scene: made.append(scene) or fields)
    assert module.own_fields(arm) is None
    assert module.ensure_fields(arm).digest == module.ensure_fields(arm).digest == fields.digest and made == [arm]
