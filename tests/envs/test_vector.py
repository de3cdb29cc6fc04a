"""Row i of a vector environment with seed s is the single environment with seed s + i, bit for bit."""

import copy

import numpy as np
import pytest
from gymnasium.error import ClosedEnvironmentError, ResetNeeded

from soft_tendon_env.envs import ReachEnv, ReachVectorEnv, ShapeEnv, ShapeVectorEnv, TipPoseEnv, TipPoseVectorEnv

KINDS = {"TipPose": (TipPoseEnv, TipPoseVectorEnv), "Shape": (ShapeEnv, ShapeVectorEnv), "Reach": (ReachEnv, ReachVectorEnv)}
SMALL = {"scene": "three_tendon", "fidelity": "fast"}
LONGEST = 9


def row_of(values, row):
    """What a vector environment says of one row, as the single one would."""
    if isinstance(values, dict):
        return {key: row_of(value, row) for key, value in values.items()}
    return values[row]


def info_of(info, row):
    """The entries of a vector environment's info that belong to a row, as plain values."""
    own = {key: value for key, value in info.items() if not key.startswith("_") and isinstance(value, np.ndarray)}
    return {key: getattr(value[row], "tolist", lambda v=value[row]: v)() for key, value in own.items() if info[f"_{key}"][row]}


def single_steps(env, seed, actions, mode):
    """What one row gives: (observation, reward, terminated, truncated, info, final observation, final info) by step."""
    count, over = 0, False
    yield (*env.reset(seed=seed),)
    for action in actions:
        if over and mode == "next_step":
            observation, info = env.reset()
            count, over = 0, False
            yield observation, 0.0, False, False, info, None, None
            continue
        observation, reward, terminated, _, info = env.step(action)
        count += 1
        truncated = count == LONGEST
        over = terminated or truncated
        if over and mode == "same_step":
            final, final_info = observation, info
            observation, info = env.reset()
            count, over = 0, False
            yield observation, reward, terminated, truncated, info, final, final_info
        else:
            yield observation, reward, terminated, truncated, info, None, None


def compare(single, vector, seed, rows, mode, same, steps=40):
    actions = np.random.default_rng(1).uniform(-1.5, 1.5, (steps, rows, vector.single_action_space.shape[0]))
    alone = [single_steps(single(), seed + row, actions[:, row], mode) for row in range(rows)]
    observation, info = vector.reset(seed=seed)
    for row in range(rows):
        expected, expected_info = next(alone[row])
        assert same(row_of(observation, row), expected)
        known = info_of(info, row)
        assert known and same(known, {key: expected_info[key] for key in known})
    for action in actions:
        observation, reward, terminated, truncated, info = vector.step(action)
        for row in range(rows):
            expected = next(alone[row])
            assert same(row_of(observation, row), expected[0])
            assert (reward[row], terminated[row], truncated[row]) == expected[1:4]
            known = info_of({key: value for key, value in info.items() if not key.startswith("_final") and key != "final_obs"}, row)
            assert known.keys() >= {"diverged", "rejected_steps"} and same(known, {key: expected[4][key] for key in known})
            if expected[5] is not None:
                assert info["_final_obs"][row] and same(info["final_obs"][row], expected[5])
                assert same(info_of(info["final_info"], row), expected[6])
            else:
                assert "_final_obs" not in info or not info["_final_obs"][row]


@pytest.mark.parametrize("mode", ["next_step", "same_step"])
@pytest.mark.parametrize("task", KINDS)
def test_rows_are_single_environments(task, mode, same):
    single, vector = KINDS[task]
    compare(lambda: single(**SMALL), vector(3, LONGEST, mode, **SMALL), 10, 3, mode, same)


@pytest.mark.parametrize("mode", ["next_step", "same_step"])
@pytest.mark.parametrize("task", KINDS)
def test_rows_are_single_environments_with_everything_random(task, mode, arm, everything, same):
    single, vector = KINDS[task]
    options = {**arm, "randomize": everything, "observation": "measurable", "sensors": [0.1, 0.3], "action": "increment"}
    compare(lambda: single(**options), vector(2, LONGEST, mode, **options), 20, 2, mode, same, steps=25)


@pytest.mark.parametrize("rows", [1, 3, 17])
@pytest.mark.parametrize("task", KINDS)
def test_the_number_of_rows_changes_nothing(task, rows, same):
    """With ten tendons, whose sums NumPy takes in another order than three's."""
    single, vector = KINDS[task]
    options = {"fidelity": "fast", "observation": "measurable", "sensors": [0.5]}
    compare(lambda: single(**options), vector(rows, LONGEST, **options), 40, rows, "next_step", same, steps=12)


@pytest.mark.parametrize("threads", [1, 2, 3])
@pytest.mark.parametrize("mode", ["next_step", "same_step"])
def test_threads_change_nothing(threads, mode, everything, same):
    options = {**SMALL, "randomize": everything}
    vector = TipPoseVectorEnv(24, LONGEST, mode, threads, **options)
    assert vector.episodes.arms.threads == threads
    compare(lambda: TipPoseEnv(**options), vector, 30, 24, mode, same, steps=21)
    vector.close()


def test_rows_with_ends_of_their_own_are_single_environments(same):
    """A row that is reset alone leaves the others as they are."""
    vector = TipPoseVectorEnv(3, None, "disabled", **SMALL)
    single = [TipPoseEnv(**SMALL) for _ in range(3)]
    observation, _ = vector.reset(seed=1)
    for row, env in enumerate(single):
        assert same(env.reset(seed=1 + row)[0], observation[row])
    actions = np.random.default_rng(2).uniform(-1, 1, (30, 3, 3))
    for i, action in enumerate(actions):
        if i in (5, 6, 20):
            observation, info = vector.reset(options={"reset_mask": np.arange(3) == i % 3})
            expected, expected_info = single[i % 3].reset()
            assert same(observation[i % 3], expected)
        observation, reward, *_ = vector.step(action)
        for row, env in enumerate(single):
            expected = env.step(action[row])
            assert same(observation[row], expected[0]) and reward[row] == expected[1]


@pytest.mark.parametrize("mode", ["same_step", "next_step"])
def test_first_episodes_can_be_shorter_by_row(mode):
    """With 12 steps an episode: rows that were to end after 4, 12 (of 99) and 1 do, and have whole episodes from there on."""
    vector = TipPoseVectorEnv(3, 12, mode, **SMALL)
    vector.reset(seed=0, options={"episode_steps": [4, 99, 1]})
    ends = [[], [], []]
    for step in range(1, 31):
        truncated = vector.step(np.zeros((3, 3)))[3]
        for row in np.flatnonzero(truncated):
            ends[row].append(step)
    idle = mode == "next_step"  # a step that resets
    assert ends == [[4, 16 + idle, 28 + 2 * idle], [12, 24 + idle], [1, 13 + idle, 25 + 2 * idle]]
    vector.reset(seed=0)
    assert not any(vector.step(np.zeros((3, 3)))[3].any() for _ in range(11)), "the next reset is a usual one"


@pytest.mark.cases("steps", [[4, 4], [4, 0, 4], [4, -1, 4], "four", [1.0, np.nan, 1.0], [1, 2.5, 1], None])
def test_bad_lengths_of_first_episodes_are_refused_before_anything_changes(steps):
    vector = TipPoseVectorEnv(3, 12, **SMALL)
    vector.reset(seed=0)
    vector.step(np.zeros((3, 3)))
    with pytest.raises(ValueError, match="episode_steps should be 3 whole numbers of at least 1"):
        vector.reset(seed=0, options={"episode_steps": steps})
    assert (vector.episodes.step_count == 1).all()


def test_seeds_can_be_listed(same):
    vector = TipPoseVectorEnv(3, **SMALL)
    listed, _ = vector.reset(seed=[4, 9, 4])
    assert same(listed[0], listed[2]) and not same(listed[0], listed[1])
    assert same(TipPoseEnv(**SMALL).reset(seed=9)[0], listed[1])
    assert same(vector.reset(seed=np.int64(4))[0], vector.reset(seed=4)[0])
    again, _ = vector.reset(seed=[4, None, 4])
    assert same(again[0], listed[0]) and not same(again[1], listed[1])


def test_results_are_new_each_time(same):
    vectors = TipPoseVectorEnv(2, **SMALL), ReachVectorEnv(2, autoreset_mode="same_step", max_episode_steps=2, **SMALL)
    for env in (TipPoseEnv(**SMALL), *vectors):
        kept = [env.reset(seed=0), env.step(np.ones(env.action_space.shape))]
        copied = copy.deepcopy(kept)
        for _ in range(4):
            env.step(-np.ones(env.action_space.shape))
        assert same(kept, copied)


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


BAD_SEEDS = {
    "negative": (-1, ValueError, "seed should be a whole number of at least 0, not -1"),
    "NumPy's negative": (np.int64(-3), ValueError, "seed should be a whole number of at least 0, not -3"),
    "float": (1.0, TypeError, "seed should be a whole number of at least 0, not float"),
    "nan": (np.nan, TypeError, "seed should be .*, not float"),
    "bool": (True, TypeError, "seed should be .*, not bool"),
    "text as long as the rows": ("ab", TypeError, "seed should be .*, not str"),
    "set": ({1, 2}, TypeError, "seed should be .*, not set"),
    "table": ({0: 1, 1: 2}, TypeError, "seed should be .*, not dict"),
    "array without axes": (np.array(3), TypeError, "seed should be .*, not ndarray"),
    "short": ([1], ValueError, "seed should be an int or a list of 2, not of 1"),
    "long": (np.arange(3), ValueError, "seed should be an int or a list of 2, not of 3"),
    "text in a list": ([1, "a"], TypeError, r"seed\[1\] should be a whole number of at least 0, not str"),
    "negative in a list": ([1, -2], ValueError, r"seed\[1\] should be a whole number of at least 0, not -2"),
    "float in a list": ([1.0, 2], TypeError, r"seed\[0\] should be .*, not float"),
    "nested": ([1, [2]], TypeError, r"seed\[1\] should be .*, not list"),
    "bools": ([True, False], TypeError, r"seed\[0\] should be .*, not bool"),
}


@pytest.mark.cases("kind", KINDS)
@pytest.mark.cases("bad", BAD_SEEDS)
def test_bad_seeds_are_refused_before_anything_changes(bad, kind, everything, same):
    seed, error, message = BAD_SEEDS[bad]
    vector, twin = (KINDS[kind][1](2, **SMALL, randomize=everything) for _ in range(2))
    with pytest.raises(error, match=f"^{message}"):  # before the first reset
        vector.reset(seed=seed)
    assert same(vector.reset(seed=3), twin.reset(seed=3))
    vector.step(np.ones((2, 3)))
    with pytest.raises(error, match=f"^{message}"):
        vector.reset(seed=seed)
    twin.step(np.ones((2, 3)))
    assert same(vector.step(np.zeros((2, 3))), twin.step(np.zeros((2, 3)))) and same(vector.reset(), twin.reset())


@pytest.mark.cases("bad", list(BAD_SEEDS)[:9])
def test_bad_seeds_of_one_environment_are_refused_alike(bad, same):
    seed, error, message = BAD_SEEDS[bad]
    env, twin = TipPoseEnv(**SMALL), TipPoseEnv(**SMALL)
    env.reset(seed=1), twin.reset(seed=1)
    with pytest.raises(error, match=f"^{message}"):
        env.reset(seed=seed)
    assert same(env.reset(), twin.reset())


@pytest.mark.cases("seed", [np.int64(7), np.uint8(7), 10**30, 10**400])
def test_seeds_of_every_integer_type_and_size_are_taken(seed, same):
    vector = TipPoseVectorEnv(3, **SMALL)
    observation, _ = vector.reset(seed=seed)
    for row in range(3):
        assert same(TipPoseEnv(**SMALL).reset(seed=int(seed) + row)[0], observation[row])
    assert same(TipPoseEnv(**SMALL).reset(seed=seed)[0], observation[0])
    assert same(vector.reset(seed=[seed, None, np.int64(3)])[0][0], observation[0])
    assert same(vector.reset(seed=np.array([3, 4, 5]))[0], vector.reset(seed=3)[0])


@pytest.mark.cases("options", [3, "reset_mask", [True, False]])
@pytest.mark.cases("kind", KINDS)
def test_reset_options_that_are_no_table_are_refused(kind, options):
    for env in (KINDS[kind][0](**SMALL), KINDS[kind][1](2, **SMALL)):
        with pytest.raises(TypeError, match=f"options should be a dict or None, not {type(options).__name__}"):
            env.reset(seed=0, options=options)


@pytest.mark.cases("threads", [None, 1, 2])
@pytest.mark.cases("rows", [None, 1, 32])
def test_nothing_goes_on_after_close(rows, threads):
    """Whether there are threads or not; closing again is harmless."""
    env = TipPoseEnv(**SMALL) if rows is None else TipPoseVectorEnv(rows, threads=threads, **SMALL)
    env.reset(seed=0)
    env.step(np.zeros(env.action_space.shape))
    env.close()
    env.close()
    for called, call in {"reset": env.reset, "step": lambda: env.step(np.zeros(env.action_space.shape)), "render": env.render}.items():
        with pytest.raises(ClosedEnvironmentError, match=f"^{called} was called after close: make a new environment"):
            call()


@pytest.mark.cases("mask", [[True], [1, 0], [False, False], "all"])
def test_bad_masks_are_refused(mask):
    vector = TipPoseVectorEnv(2, **SMALL)
    vector.reset(seed=0)
    with pytest.raises(ValueError, match="reset_mask should be a bool array of shape"):
        vector.reset(options={"reset_mask": mask})


@pytest.mark.cases(
    "key, value, said",
    [
        ("num_envs", 0, "num_envs"),
        ("num_envs", 2.5, "num_envs"),
        *[("num_envs", rows, "num_envs should be at most 100000, not 10") for rows in (10**6, 10**30, np.int64(10**18))],
        ("max_episode_steps", 0, "max_episode_steps"),
        ("threads", 0, "threads"),
        ("threads", "all", "threads"),
        ("autoreset_mode", "samestep", "autoreset_mode is 'samestep': did you mean 'same_step'"),
    ],
)
def test_bad_counts_and_modes_are_refused_by_name(key, value, said):
    with pytest.raises((ValueError, TypeError), match=said):
        TipPoseVectorEnv(**{"num_envs": 1, key: value}, **SMALL)


@pytest.mark.cases("goals", [([0.0] * 2, [0.0] * 2), (np.zeros((2, 3)), np.zeros((3, 3))), (None, None), ("a", "b"), (0, [0, 0, 0])])
@pytest.mark.cases("kind", [ReachEnv, ReachVectorEnv])
def test_goals_of_other_shapes_are_refused(kind, goals):
    with pytest.raises(ValueError, match="achieved_goal and desired_goal should have the same shape"):
        kind(**SMALL).compute_reward(*goals, {})


@pytest.mark.parametrize("task", KINDS)
def test_a_reset_erases_what_was(task, arm, everything, live, same):
    options = {**arm, "randomize": everything, "tension_limits": [0.0, 10.0]}
    env = KINDS[task][0](**options)
    live(env, 1, 60, np.random.default_rng(0).choice([-1.0, 1.0], (60, 3)))
    fresh = KINDS[task][0](**options)
    assert same(live(env, 2, 30), live(fresh, 2, 30)) and not same(live(env, 3, 2), live(fresh, 4, 2))
