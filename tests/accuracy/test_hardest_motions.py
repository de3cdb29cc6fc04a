"""Hardest motions: other models err most, or nearly so, in the draw that was found, and commands of
elastic tendons pull as hard as tensions would."""

import numpy as np
import pytest

from soft_tendon_env.accuracy import hardest_motions as module
from soft_tendon_env.accuracy.hardest_motions import DRAWS, HardestMotions, pulling_commands
from soft_tendon_env.accuracy.input_motions import motion_tensions
from soft_tendon_env.accuracy.reference import distance, tip_path
from soft_tendon_env.model.build import build_model
from soft_tendon_env.scene.file import load_scene

THREE = load_scene("three_tendon")
SPRINGS = {"stiffness": 900.0, "displacement_limits": [-0.002, 0.006], "slack": [0.0, 0.001, 0.002]}


def arm(damping, **changes):
    return THREE.replace(
        {
            "segments.0.length": 0.31,
            "segments.0.young_modulus": 6e5,
            "segments.0.damping": damping,
            **changes,
        }
    )


@pytest.mark.parametrize(
    ("kind", "damping"), [("redrawn", 4e2), ("smooth", 4e2), ("increments", 4e3)]
)
def test_a_model_of_other_coordinates_errs_most_in_the_hardest_draw(kind, damping):
    """Or nearly so, against explicit strain."""
    scene = arm(damping)
    moments = {"strains": ["torsion", "bend_y", "bend_z"], "order": 4, "span": "rod"}
    modes = {"strains": list(scene.strain.free), "order": 6, "span": "rod"}
    steps = {"tolerance": 1e-5, "max_halvings": 16}
    strain = {"type": "statics_based", "passive": [moments]}
    changes = {"strain": strain, "integrator": steps}
    model = build_model(scene.replace(changes))
    explicit = {"type": "explicit", "modes": [modes]}
    exact = build_model(scene.replace({"strain": explicit, "integrator": steps}))

    draws = [motion_tensions(scene, kind, seed, 2.0) for seed in range(40, 40 + DRAWS)]
    errors = []
    for draw in draws:
        path = tip_path(model, draw)
        exact_path = tip_path(exact, draw)
        errors.append(distance(path, exact_path))
    hardest = HardestMotions(scene).hardest(kind, 40, 2.0)
    (place,) = [place for place, draw in enumerate(draws) if np.array_equal(draw, hardest)]
    assert errors[place] >= 0.8 * max(errors)
    assert errors[place] >= 1.2 * np.median(errors)


def test_the_hardest_draw_is_that_in_which_models_are_farthest_apart(monkeypatch):
    """One that the richer of them cannot follow is no draw to judge by."""
    motions = HardestMotions(arm(4e3))
    draws = [motion_tensions(motions.scene, "step", seed, 0.04) for seed in range(7, 7 + DRAWS)]
    far = [0.1, 0.3, 0.2, None, 0.3, 0.0, 0.25, 0.1]

    def path(model, commands, start):
        (place,) = [p for p, draw in enumerate(draws) if np.array_equal(draw, commands)]
        away = 0.0
        if far[place] is None:
            if model is motions._rich:
                return None
        elif model is motions._coarse:
            away = far[place]
        return np.full((1, 3), away)

    monkeypatch.setattr(module, "tip_path", path)
    np.testing.assert_array_equal(motions.hardest("step", 7, 0.04), draws[1])


def test_an_arm_that_rests_nowhere_has_the_first_draw(monkeypatch):
    monkeypatch.setattr(module, "start_at_rest", lambda model: None)
    scene = arm(4e3)
    hardest = HardestMotions(scene).hardest("redrawn", 3, 0.2)
    expected_hardest = motion_tensions(scene, "redrawn", 3, 0.2)
    np.testing.assert_array_equal(hardest, expected_hardest)


def test_commands_of_stiff_tendons_are_tensions():
    model = build_model(THREE)
    tensions = motion_tensions(THREE, "redrawn", 5, 0.1)
    still = np.zeros(model.coordinate_count)
    assert pulling_commands(model, tensions, still) is tensions


def test_displacements_pull_with_tensions_at_an_arm_that_is_held():
    """T = k (delta - l - (L_0 - L)), as far as actuators go."""
    scene = THREE.replace({"effects.tendon_elasticity": SPRINGS})
    model = build_model(scene)
    shape = np.array([0.4, 0.1, 0.7])
    tensions = motion_tensions(scene, "wild", 6, 0.2)
    commands = pulling_commands(model, tensions, shape)

    lengths = model.tendon_lengths(np.zeros(3)) - model.tendon_lengths(shape)
    stretch = commands - np.array(SPRINGS["slack"]) - lengths
    least, greatest = SPRINGS["displacement_limits"]
    is_within = (commands > least) & (commands < greatest)
    assert 0.1 < is_within.mean() < 1.0
    np.testing.assert_allclose(900.0 * stretch[is_within], tensions[is_within], rtol=1e-9)
    assert commands.min() >= least
    assert commands.max() == greatest
