"""Learned strain under dead loads: what is learned, how well on unseen tensions, that it is the same again, and what is refused."""

import numpy as np
import pytest

from soft_tendon_env.accuracy import loaded_strain
from soft_tendon_env.accuracy.loaded_strain import Training, exact_model, learn_loaded_strain, learned_model
from soft_tendon_env.model.statics import static_equilibrium
from soft_tendon_env.scene.file import load_scene
from soft_tendon_env.tools.configuration import ConfigurationError

GRAVITY = {"effects.gravity.acceleration": [0.0, 0.0, -9.81]}
LIMITS = {f"tendons.{i}.tension_limits": [0.0, 2.0] for i in range(3)}
ARM = load_scene("three_tendon").replace({**GRAVITY, **LIMITS, "effects.tip_load.mass": 0.005})
SMALL = Training(samples=1500, epochs=20, iterations=150, fields=6, hidden=16)


@pytest.fixture(scope="module")
def learned():
    return learn_loaded_strain(ARM, SMALL)


def test_unseen_tensions_are_within_a_hundredth_of_what_the_loads_do(learned):
    errors = learned.errors
    assert errors["unsettled"] == 0 and errors["loads_rms"] > 0.05
    for name in ("tip_rms", "rest_rms"):
        assert errors[name] < 0.01 * errors["loads_rms"]
    assert errors["rest_largest"] < 0.05 * errors["loads_rms"] and errors["strain_rms"] < 0.03


def test_the_stated_errors_are_those_of_the_model(learned):
    """On other tensions than they were measured with: at rest, the tip beside that of the exact strain."""
    exact, own = exact_model(ARM), learned_model(exact_model(ARM).scene, learned, 12)
    random, apart = np.random.default_rng(7), []
    for _ in range(40):
        u = random.uniform(0.0, 2.0, 3)
        found = static_equilibrium(own, u)
        assert found.converged and found.stable
        apart.append(np.linalg.norm(found.tip_pose[:3, 3] - exact.tip_pose(u)[:3, 3]))
        assert found.tip_error == pytest.approx(apart[-1], abs=1e-9)
    assert 0.2 * learned.errors["rest_rms"] < np.sqrt(np.mean(np.square(apart))) < 3.0 * learned.errors["rest_rms"]


def test_the_same_seed_learns_the_same(learned, monkeypatch):
    monkeypatch.setattr(loaded_strain, "TESTS", 2)
    monkeypatch.setattr(loaded_strain, "processors", lambda: 1)
    assert learn_loaded_strain(ARM, SMALL).digest == learned.digest
    assert learn_loaded_strain(ARM, SMALL._replace(seed=1, iterations=1)).digest != learned.digest


def test_it_covers_the_limits_and_a_margin(learned):
    assert learned.fits(ARM) and not learned.misfit(ARM)
    np.testing.assert_array_equal(learned.tension_limits, [[0, 2]] * 3)
    assert (learned.coordinate_range[:, 0] < -0.3).all() and (learned.coordinate_range[:, 1] > 2.1).all()


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"effects": {}}, "effects has no dead loads to learn the strain under"),
        ({"effects.gravity.acceleration": [-200.0, 0.0, 0.0]}, "weigh more than the arm holds without tensions"),
        ({"strain": {"type": "explicit", "modes": [{"strains": ["bend_y"], "order": 1, "span": "rod"}]}}, 'should be "statics_based"'),
    ],
)
def test_scenes_that_cannot_be_learned_are_refused(changes, words):
    with pytest.raises(ConfigurationError, match=words):
        learn_loaded_strain(ARM.replace(changes))
