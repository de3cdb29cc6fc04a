"""Row i of a vector environment with seed s is the single environment with seed s + i; what reset
and step refuse."""

import numpy as np
import pytest
from gymnasium.error import ClosedEnvironmentError, ResetNeeded

from soft_tendon_env.envs import (
    ReachEnv,
    ReachVectorEnv,
    ShapeEnv,
    ShapeVectorEnv,
    TipPoseEnv,
    TipPoseVectorEnv,
)

KINDS = {
    "TipPose": (TipPoseEnv, TipPoseVectorEnv),
    "Shape": (ShapeEnv, ShapeVectorEnv),
    "Reach": (ReachEnv, ReachVectorEnv),
}
SMALL = {"scene": "three_tendon", "fidelity": "fast"}
LONGEST = 9
MORE = {
    "elastic": {
        "effects.tendon_elasticity": {"stiffness": 5e3, "displacement_limits": [-0.002, 0.012]},
        "effects.actuators.delay": 0.033,
    },
    "contact": {
        "effects.contact": {
            "obstacles": [{"type": "plane", "position": [0.0, 0.0, -0.04]}],
            "friction": 0.4,
        }
    },
}
SEED = "seed should be"
MASK = "reset_mask should be a bool array of shape"


def row_of(values, row):
    """What a vector environment says of one row, as the single one would."""
    if isinstance(values, dict):
        return {key: row_of(value, row) for key, value in values.items()}
    return values[row]


def info_of(info, row):
    """The entries of a vector environment's info that belong to a row, as plain values."""
    entries = {
        key: value
        for key, value in info.items()
        if not key.startswith("_") and isinstance(value, np.ndarray)
    }
    return {
        key: getattr(value[row], "tolist", lambda v=value[row]: v)()
        for key, value in entries.items()
        if info[f"_{key}"][row]
    }


def single_steps(env, seed, actions, mode):
    """What one row gives: (observation, reward, terminated, truncated, info, final observation,
    final info) by step."""
    count = 0
    over = False
    yield (*env.reset(seed=seed),)
    for action in actions:
        if over and mode == "next_step":
            observation, info = env.reset()
            count = 0
            over = False
            yield observation, 0.0, False, False, info, None, None
            continue
        observation, reward, terminated, _, info = env.step(action)
        count += 1
        truncated = count == LONGEST
        over = terminated or truncated
        if over and mode == "same_step":
            final = observation
            final_info = info
            observation, info = env.reset()
            count = 0
            over = False
            yield observation, reward, terminated, truncated, info, final, final_info
        else:
            yield observation, reward, terminated, truncated, info, None, None


def compare(single, vector, seed, rows, mode, same, steps=40):
    actions = np.random.default_rng(1).uniform(
        -1.5, 1.5, (steps, rows, vector.single_action_space.shape[0])
    )
    alone = [single_steps(single(), seed + row, actions[:, row], mode) for row in range(rows)]
    observation, info = vector.reset(seed=seed)
    for row in range(rows):
        expected, expected_info = next(alone[row])
        assert same(row_of(observation, row), expected)
        known = info_of(info, row)
        assert known
        assert same(known, {key: expected_info[key] for key in known})
    for action in actions:
        observation, reward, terminated, truncated, info = vector.step(action)
        for row in range(rows):
            expected = next(alone[row])
            assert same(row_of(observation, row), expected[0])
            ended = (reward[row], terminated[row], truncated[row])
            assert ended == expected[1:4]
            known = info_of(
                {
                    key: value
                    for key, value in info.items()
                    if not key.startswith("_final") and key != "final_obs"
                },
                row,
            )
            assert known.keys() >= {"diverged", "rejected_steps"}
            assert same(known, {key: expected[4][key] for key in known})
            if expected[5] is not None:
                assert info["_final_obs"][row]
                assert same(info["final_obs"][row], expected[5])
                assert same(info_of(info["final_info"], row), expected[6])
            else:
                assert "_final_obs" not in info or not info["_final_obs"][row]


@pytest.mark.parametrize("mode", ["next_step", "same_step"])
@pytest.mark.parametrize("task", KINDS)
def test_rows_are_single_environments(task, mode, same):
    single, vector = KINDS[task]
    envs = vector(3, LONGEST, mode, **SMALL)
    compare(lambda: single(**SMALL), envs, 10, 3, mode, same)


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["loaded", "explicit", "elastic", "contact"])
def test_rows_are_single_environments_with_everything_random(kind, arms, everything, same):
    """On threads, with more rows than fill a share of them."""
    made = (
        {"scene": {"scene": "three_tendon", **MORE[kind]}, "fidelity": "fast"}
        if kind in MORE
        else arms[kind]
    )
    options = {
        **made,
        "randomize": everything,
        "observation": "measurable",
        "history": 2,
        "sensors": [0.1, 0.3],
        "action": "increment",
    }
    vector = TipPoseVectorEnv(16, LONGEST, "same_step", 2, **options)
    assert vector.episodes.arms.threads == 2
    compare(lambda: TipPoseEnv(**options), vector, 20, 16, "same_step", same, steps=10)
    vector.close()


def test_ended_rows_must_be_reset_where_nothing_resets_them():
    vector = TipPoseVectorEnv(2, 1, "disabled", **SMALL)
    with pytest.raises(ResetNeeded, match="first reset"):
        vector.reset(options={"reset_mask": np.array([True, False])})
    vector.reset(seed=0)
    vector.step(np.zeros((2, 3)))
    with pytest.raises(ResetNeeded, match=r"rows \[0, 1\] have ended"):
        vector.step(np.zeros((2, 3)))
    vector.reset(options={"reset_mask": np.array([True, True])})
    vector.step(np.zeros((2, 3)))


@pytest.mark.slow
@pytest.mark.parametrize(
    ("given", "message"),
    [
        ({"seed": -1}, "seed should be a whole number of at least 0, not -1"),
        ({"seed": 1.0}, f"{SEED} .*, not float"),
        ({"seed": True}, f"{SEED} .*, not bool"),
        ({"seed": "ab"}, f"{SEED} .*, not str"),
        ({"seed": [1]}, "seed should be an int or a list of 2, not of 1"),
        ({"seed": [1, -2]}, r"seed\[1\] should be a whole number of at least 0, not -2"),
        ({"seed": [True, False]}, r"seed\[0\] should be .*, not bool"),
        ({"options": "reset_mask"}, "options should be a dict or None, not str"),
        ({"options": {"reset_mask": [1, 0]}}, MASK),
        ({"options": {"reset_mask": [False, False]}}, MASK),
        (
            {"options": {"episode_steps": [4]}},
            "options: episode_steps should have one value per row, 2",
        ),
        (
            {"options": {"episode_steps": [1, 2.5]}},
            "options of row 1: episode_steps is 2.5: it should be a valid integer",
        ),
        (
            {"options": {"episode_steps": [0, 1]}},
            "options of row 0: episode_steps is 0: it should be greater than or equal to 1",
        ),
    ],
)
def test_bad_arguments_of_reset_are_refused_before_anything_changes(
    given, message, everything, same
):
    vector = TipPoseVectorEnv(2, **SMALL, randomize=everything)
    twin = TipPoseVectorEnv(2, **SMALL, randomize=everything)
    for env in (vector, twin):
        env.reset(seed=3)
        env.step(np.ones((2, 3)))
    with pytest.raises((ValueError, TypeError), match=f"^{message}"):
        vector.reset(**given)
    stepped = vector.step(np.zeros((2, 3)))
    expected = twin.step(np.zeros((2, 3)))
    assert same(stepped, expected)
    assert same(vector.reset(), twin.reset())


@pytest.mark.parametrize(("rows", "threads"), [(None, None), (1, None), (32, 2)])
def test_nothing_goes_on_after_close(rows, threads):
    """Whether there are threads or not; closing again is harmless."""
    if rows is None:
        env = TipPoseEnv(**SMALL)
    else:
        env = TipPoseVectorEnv(rows, threads=threads, **SMALL)
    env.reset(seed=0)
    env.step(np.zeros(env.action_space.shape))
    env.close()
    env.close()
    for called, call in {
        "reset": env.reset,
        "step": lambda: env.step(np.zeros(env.action_space.shape)),
        "render": env.render,
    }.items():
        with pytest.raises(
            ClosedEnvironmentError,
            match=f"^{called} was called after close: make a new environment",
        ):
            call()


@pytest.mark.parametrize(
    ("key", "value", "said"),
    [
        ("num_envs", 0, "num_envs"),
        ("max_episode_steps", 0, "max_episode_steps"),
        ("threads", "all", "threads"),
        ("autoreset_mode", "samestep", "autoreset_mode is 'samestep': did you mean 'same_step'"),
    ],
)
def test_bad_counts_and_modes_are_refused_by_name(key, value, said):
    with pytest.raises((ValueError, TypeError), match=said):
        TipPoseVectorEnv(**{"num_envs": 1, key: value}, **SMALL)


@pytest.mark.parametrize("task", KINDS)
def test_a_reset_erases_what_was(task, arms, everything, live, same):
    options = {**arms["loaded"], "randomize": everything, "tension_limits": [0.0, 10.0]}
    env = KINDS[task][0](**options)
    rng = np.random.default_rng(0)
    actions = rng.choice([-1.0, 1.0], (60, 3))
    live(env, 1, 60, actions)
    fresh = KINDS[task][0](**options)
    assert same(live(env, 2, 30), live(fresh, 2, 30))
    assert not same(live(env, 3, 2), live(fresh, 4, 2))


def test_the_seed_of_a_reset_is_that_of_the_environment():
    """As Gymnasium's own vector environments have it; a reset without one changes nothing."""
    vector = TipPoseVectorEnv(num_envs=3, **SMALL)
    vector.reset(seed=7)
    assert vector.np_random_seed == 7
    drawn = vector.np_random.random()
    bits = np.random.PCG64(np.random.SeedSequence(7))
    assert drawn == np.random.Generator(bits).random()
    vector.reset()
    assert vector.np_random_seed == 7
    vector.reset(seed=[4, None, 5])
    assert vector.np_random_seed == 7


@pytest.mark.parametrize(("count", "head_start"), [(32, 2), (32, 0), (31, 2), (4, 2), (1, 0)])
def test_threads_take_every_row_once(count, head_start):
    """In order, as many each, the first more by its head start; few rows stay on one thread."""
    env = TipPoseVectorEnv(32, threads=3, **SMALL)
    rows = np.arange(32)
    members = rows[:count]
    parts = []
    scratches = set()

    def take(part, scratch):
        parts.append(part)
        scratches.add(id(scratch))

    env.episodes.arms.map_rows(take, members, head_start)
    env.close()
    parts.sort(key=lambda part: part[0])
    together = np.concatenate(parts)
    np.testing.assert_array_equal(together, members)
    is_alone = count < 3 + head_start
    threads = 1 if is_alone else 3
    assert len(parts) == threads
    assert len(scratches) == threads
    if is_alone:
        return
    sizes = np.array([part.size for part in parts])
    sizes[0] -= head_start
    assert np.ptp(sizes) <= 1
