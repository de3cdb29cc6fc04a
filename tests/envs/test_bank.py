"""Banks of targets: courses that depend on their numbers alone, shared by episodes, each from a drawn control period on."""

import numpy as np
import pytest

from soft_tendon_env.envs import ShapeVectorEnv, TipPoseEnv, TipPoseVectorEnv
from soft_tendon_env.envs.options import without_bank
from soft_tendon_env.envs.starts import BANK_SEED
from soft_tendon_env.evaluation import evaluate_rows
from soft_tendon_env.policies.protocol import FunctionPolicy
from soft_tendon_env.tools.configuration import ConfigurationError

TARGET = {"type": "random", "period": 2.0, "knot_period": 0.5}
BANK = {**TARGET, "bank": 3}
PERIODS = 100


def followed(env, steps):
    """Targets of rows over so many control periods, (steps, rows, ..) of each field, previews too."""
    found = []
    for _ in range(steps):
        found.append(env.episodes.target)
        env.step(np.zeros(env.action_space.shape))
    return type(found[0])(*(np.stack(field) for field in zip(*found, strict=True)))


@pytest.mark.parametrize("vector", [TipPoseVectorEnv, ShapeVectorEnv])
def test_rows_are_single_environments_whatever_was_asked_for_before(vector, arm):
    env, alone = (vector(rows, **arm, preview=[0.1], target=BANK) for rows in (3, 1))
    env.reset(seed=5)
    rows = followed(env, 150)
    alone.reset(seed=50)
    for row in (2, 0):
        alone.reset(seed=5 + row)
        for single, together in zip(followed(alone, 150), rows, strict=True):
            np.testing.assert_array_equal(single[:, 0], together[:, row])
    for field in rows:
        np.testing.assert_array_equal(field[:-5, :, 1], field[5:, :, 0], err_msg="previews come true")


def test_targets_are_courses_that_are_drawn_from_any_control_period_on(arm):
    env, own = TipPoseEnv(**arm, target=BANK), TipPoseEnv(**arm, target=TARGET)
    own.reset(seed=0)
    times, expected = 0.02 * np.arange(PERIODS), []
    for number in range(3):
        starts = own.episodes.starts
        own.episodes._courses.begin(0, *starts.draw_course(starts.usual.target, np.random.default_rng(BANK_SEED + number), starts._setting))
        expected.append(own.target_at(times).tip_pose)
    seen = set()
    for seed in range(12):
        env.reset(seed=seed)
        found, first = env.target_at(times).tip_pose, env.episodes._courses._first[0]
        np.testing.assert_allclose(found[0], env.episodes.target_pose[0], rtol=0.0, atol=1e-12)
        off = [np.abs(np.roll(course, -first, axis=0) - found).max() for course in expected]
        assert min(off) < 1e-9
        seen.add((int(np.argmin(off)), int(first)))
    assert {number for number, _ in seen} == {0, 1, 2} and len(seen) > 6


def test_drawn_obstacles_are_refused():
    obstacles = {"obstacles": [{"type": "sphere", "radius": 0.02, "position": [0.1, 0.2, 0.0]}]}
    scene, effects = {"scene": "three_tendon", "effects.contact": obstacles}, {"contact.obstacles.0.radius": [0.01, 0.02]}
    with pytest.raises(ConfigurationError, match="target.bank is 3: it should be left out where obstacles are drawn"):
        TipPoseEnv(scene=scene, fidelity="fast", target=BANK, randomize={"effects": effects})


def test_policies_are_judged_on_targets_of_their_own():
    options = without_bank({"target": BANK, "fidelity": "fast"})
    assert options["fidelity"] == "fast" and "bank" not in options["target"] and options["target"].items() >= TARGET.items()
    assert without_bank({"target": "circle"}) == {"target": "circle"}
    with pytest.raises(ConfigurationError, match="target.bank is 3: it is for trainings, and should be left out where policies are judged"):
        evaluate_rows(FunctionPolicy(lambda seen: np.zeros((len(seen), 3))), TipPoseVectorEnv(1, fidelity="fast", target=BANK), [0])
