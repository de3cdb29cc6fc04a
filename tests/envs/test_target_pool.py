"""Pools of targets: courses that are those that episodes draw, without a seam, made once, and kept from evaluations."""

import numpy as np
import pytest

from soft_tendon_env.compiler import cache_folder
from soft_tendon_env.envs import ShapeVectorEnv, TipPoseEnv, TipPoseVectorEnv, courses, target_pool
from soft_tendon_env.envs.options import without_pool
from soft_tendon_env.evaluation import evaluate_rows
from soft_tendon_env.evaluation.settings import EpisodeSettings
from soft_tendon_env.tools.configuration import ConfigurationError

PERIODS = 100
TARGET = {"type": "random", "period": 2.0, "knot_period": 0.5}
POOLED = {**TARGET, "pool": 3}
OBSERVED = ["tip_position", "target_error", "preview", "inverse_statics"]


@pytest.fixture(autouse=True)
def cache(tmp_path, monkeypatch):
    """The folder of pools in a user's cache of its own."""
    monkeypatch.setattr(cache_folder, "cache_parents", lambda: [("own", lambda: tmp_path)])
    return tmp_path / "soft_tendon_env" / "targets"


@pytest.fixture
def make(arm):
    """make(): rows with inverse statics of targets from a pool, `make(target=..)` of others."""
    return lambda rows=4, **options: TipPoseVectorEnv(rows, **{**arm, "target": POOLED, "observation": OBSERVED, **options})


def followed(env, steps):
    """Targets of rows over so many control periods, (steps, rows, ..) of each field, previews too."""
    found = []
    for _ in range(steps):
        found.append(env.episodes.target)
        env.step(np.zeros(env.action_space.shape))
    return type(found[0])(*(np.stack(field) for field in zip(*found, strict=True)))


def drawn(env, number):
    """The course of that number as an episode with a course of its own draws it, over two periods: inverse statics have settled then."""
    episodes, generator = env.episodes, np.random.default_rng(target_pool.FIRST_SEED + int(number))
    env.reset(seed=0)
    episodes.starts.begin_course(0, generator, episodes.starts.q, episodes._courses)
    return followed(env, 2 * PERIODS)


def test_targets_are_courses_that_are_drawn_from_any_time_on(make):
    pooled, fresh = make(), make(rows=1, target=TARGET)
    pooled.reset(seed=0)
    numbers, first = pooled.episodes._courses._drawn.T.copy()
    assert len(set(first)) == 4, "the seeds are chosen so that rows begin at different times"
    shown = followed(pooled, PERIODS)
    for row in range(4):
        own = drawn(fresh, numbers[row])
        places = (first[row] + np.arange(PERIODS)) % PERIODS + PERIODS  # of the second period
        for name, tolerance in (("tip_pose", 1e-12), ("tip_twist", 1e-12), ("tendon_length", 1e-6 * fresh.episodes.model.length)):
            expected = getattr(own, name)[places, 0, 0]
            np.testing.assert_allclose(getattr(shown, name)[:, row, 0], expected, rtol=0.0, atol=tolerance, err_msg=name)


def test_they_begin_again_without_a_jump(make):
    env = make()
    env.reset(seed=0)
    shown = followed(env, 3 * PERIODS)
    for name in ("tip_pose", "tip_twist", "tendon_length"):
        values = getattr(shown, name)[:, :, 0]
        np.testing.assert_array_equal(values[:PERIODS], values[PERIODS : 2 * PERIODS], err_msg=name)
        for row, first in enumerate(env.episodes._courses._drawn[:, 1]):
            course = np.roll(values[:PERIODS, row].reshape(PERIODS, -1), first, axis=0)  # from its beginning
            bends = np.abs(np.roll(course, 1, axis=0) - 2.0 * course + np.roll(course, -1, axis=0)).max(axis=1)
            assert max(bends[-1], bends[0]) <= 1.2 * bends[1:-1].max(), f"{name} of row {row} at the seam, and elsewhere"


@pytest.mark.parametrize("vector", [TipPoseVectorEnv, ShapeVectorEnv])
def test_previews_come_true_and_rows_are_single_environments(vector, arm):
    options = {**arm, "target": POOLED, "preview": [0.1]}
    env = vector(3, **options)
    env.reset(seed=5)
    shown = followed(env, 150)
    for field in shown:
        np.testing.assert_array_equal(field[:-5, :, 1], field[5:, :, 0])
    single = vector(1, **options)
    single.reset(seed=7)
    for alone, together in zip(followed(single, 150), shown, strict=True):
        np.testing.assert_array_equal(alone[:, 0], together[:, 2])


def test_shapes_are_those_of_the_courses(arm):
    pooled, fresh = (ShapeVectorEnv(1, **arm, target=target) for target in (POOLED, TARGET))
    pooled.reset(seed=3)
    number, first = pooled.episodes._courses._drawn[0]
    shown, own = followed(pooled, PERIODS), drawn(fresh, number)
    places = (first + np.arange(PERIODS)) % PERIODS + PERIODS
    for name, field in shown._asdict().items():
        np.testing.assert_allclose(field, getattr(own, name)[places], rtol=0.0, atol=1e-9, err_msg=name)


def test_a_pool_is_made_once_whatever_is_drawn_of_the_arm(make, cache, monkeypatch):
    make()
    (made,) = cache.glob("*.npz")
    content = made.read_bytes()
    with monkeypatch.context() as patch:
        patch.setattr(target_pool, "_courses", None)
        make(rows=1)
        make(randomize={"stiffness": [0.9, 1.1], "latency": [0.0, 0.02]}, history=2, preview=[0.3])
    made.write_bytes(content[:1000])
    target_pool._read.cache_clear()
    make()
    assert made.read_bytes() == content, "a damaged one is made anew, the same"
    make(target={**POOLED, "pool": 2})
    make(control_period=0.04)
    make(observation=["tip_position", "target_error"])
    make(target={**POOLED, "fraction": 0.3})
    assert len(list(cache.glob("*.npz"))) == 5


def test_few_pools_are_kept(make, cache, monkeypatch):
    monkeypatch.setattr(target_pool, "KEPT", 2)
    observation = ["tip_position", "target_error"]
    for pool in (1, 2, 3):
        make(target={**POOLED, "pool": pool}, observation=observation)
    assert len(list(cache.glob("*.npz"))) == 2


def test_courses_whose_inverse_statics_do_not_come_back_are_drawn_again(make, monkeypatch):
    asked = []
    one_period = courses.Courses.one_period

    def fails_first(self, row, periods):
        asked.append(self._course[row])
        return None if len(asked) == 1 else one_period(self, row, periods)

    with monkeypatch.context() as patch:
        patch.setattr(courses.Courses, "one_period", fails_first)
        make(target={**POOLED, "pool": 1})
    assert len(asked) == 2
    assert asked[0] is not asked[1]
    monkeypatch.setattr(courses, "SEAM", -1.0)
    monkeypatch.setattr(target_pool, "MOST_DRAWS", 2)
    with pytest.raises(ConfigurationError, match="those of 2 draws out of 2 do not"):
        make(target={**POOLED, "pool": 2})


OBSTACLE = {"scene": "three_tendon", "effects.contact": {"obstacles": [{"type": "sphere", "radius": 0.02, "position": [0.1, 0.2, 0.0]}]}}


@pytest.mark.cases(
    "options, message",
    [
        ({"target": {"type": "hold", "pool": 3}}, "target.pool is 3: it is for targets that are drawn and repeat, .* not for 'hold'"),
        ({"target": {"type": "ramp", "tension": [1.0, 0.0, 0.0], "pool": 3}}, "not for 'ramp'"),
        ({"target": {"type": "circle", "pool": 3}}, "not for 'circle'"),
        ({"target": POOLED, "control_period": 0.03}, "after whole control periods, 0.03 s, not after 2 s"),
        ({"target": {**TARGET, "pool": 0}}, "target.pool is 0: it should be greater than or equal to 1"),
        ({"target": {**TARGET, "pool": 100_000}}, r"target.pool is 100000: it should be at most \d+, whose courses of 100 control periods"),
        (
            {"target": POOLED, "scene": OBSTACLE, "randomize": {"effects": {"contact.obstacles.0.radius": [0.01, 0.02]}}},
            "does not go with randomize.effects of contact",
        ),
    ],
)
def test_what_a_pool_cannot_be_is_said(options, message, cache):
    with pytest.raises(ConfigurationError, match=message):
        TipPoseEnv(**{"scene": "three_tendon", "fidelity": "fast", **options})
    assert not list(cache.glob("*.npz"))


def test_other_targets_that_repeat_have_pools(make):
    env = make(target={"type": "steps", "duration": 0.5, "count": 4, "pool": 2})
    env.reset(seed=0)
    shown = followed(env, 2 * PERIODS)
    for field in shown:
        np.testing.assert_array_equal(field[:PERIODS], field[PERIODS:])
    moves = np.abs(np.diff(shown.tip_pose[:, :, 0], axis=0)).max(axis=(2, 3)) > 1e-6
    assert (moves[:PERIODS].sum(axis=0) == 4).all()


def test_policies_are_not_judged_on_a_pool(make):
    class Still:
        def predict(self, observation, state=None, episode_start=None, deterministic=True):
            return np.zeros((4, 3)), None

    env = make()
    with pytest.raises(ConfigurationError, match="target.pool is 3: it is for trainings"):
        evaluate_rows(Still(), env, [0, 1, 2, 3])
    with pytest.raises(ConfigurationError, match=r"target.pool is 3: it is for trainings"):
        EpisodeSettings(options={"target": POOLED})
    with pytest.raises(ValueError, match="known at control periods alone"):
        env.episodes.target_at(0, np.zeros(1))
    options = without_pool({"target": POOLED, "fidelity": "fast"})
    assert options["fidelity"] == "fast"
    assert "pool" not in options["target"]
    assert options["target"].items() >= TARGET.items()
    assert without_pool({"target": "random"}) == {"target": "random"}
