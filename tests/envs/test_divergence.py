"""Where no time step succeeds: episodes end in order, other rows go on, and the end can be lived through again."""

from pathlib import Path

import numpy as np
import pytest

from soft_tendon_env.envs import ReachEnv, ShapeEnv, TipPoseEnv, TipPoseVectorEnv, replay_divergence
from soft_tendon_env.model.simulation import Simulation, SimulationDiverged

# Tendons that push or pull far past what the section holds, and no second try at smaller steps.
WILD = {
    "scene": {"scene": "three_tendon", "integrator.max_halvings": 0},
    "fidelity": None,
    "tension_limits": [-600.0, 600.0],
    "control_period": 0.05,
}


def until_divergence(env, seed=0, steps=200):
    """The step at which a saturated episode ends; the observations before it."""
    observation, _ = env.reset(seed=seed)
    rng, seen = np.random.default_rng(seed), [observation]
    for _ in range(steps):
        result = env.step(rng.choice([-1.0, 1.0], env.action_space.shape))
        seen.append(result[0])
        if result[2] or result[3]:
            return result, seen
    raise AssertionError("nothing diverged")


@pytest.mark.parametrize("how", ["terminate", "truncate"])
def test_a_divergence_ends_the_episode(how):
    env = TipPoseEnv(**WILD, on_divergence=how)
    (observation, reward, terminated, truncated, info), _ = until_divergence(env)
    assert (terminated, truncated) == (how == "terminate", how == "truncate")
    assert reward == 0.0 and info["diverged"] is True and isinstance(info["cause"], str) and info["cause"]
    assert env.observation_space.contains(observation) and np.isfinite(observation).all()
    assert all(np.isfinite(value) for value in info.values() if not isinstance(value, str))
    observation, info = env.reset()
    assert info["diverged"] is False and "cause" not in info


def test_the_last_good_state_is_that_of_a_simulation():
    """Several integrator steps make a period, and the failing one need not be its first."""
    env = TipPoseEnv(**WILD, on_divergence="raise")
    env.reset(seed=1)
    simulation, rng, times = Simulation(env.episodes.model), np.random.default_rng(1), []
    for _ in range(10):
        action = rng.choice([-1.0, 1.0], 3)
        try:
            env.step(action)
        except SimulationDiverged as error:
            with pytest.raises(SimulationDiverged) as expected:
                simulation.step(600.0 * action, 0.05)
            assert error.state.time == pytest.approx(expected.value.state.time, abs=1e-12) and error.cause in expected.value.cause
            for name in ("q", "q_dot", "strain"):
                np.testing.assert_array_equal(getattr(error.state, name), getattr(expected.value.state, name))
            times.append(error.state.time)
            env.reset()
            simulation.reset()
        else:
            simulation.step(600.0 * action, 0.05)
    assert times


def test_a_diverged_goal_is_not_rewarded():
    (observation, reward, terminated, _, info), _ = until_divergence(ReachEnv(**WILD, reward="dense"))
    assert terminated and reward == 0.0 and info["diverged"] and all(np.isfinite(value).all() for value in observation.values())


def test_a_divergence_can_be_raised():
    with pytest.raises(SimulationDiverged) as caught:
        until_divergence(TipPoseEnv(**WILD, on_divergence="raise"))
    assert caught.value.cause in str(caught.value) and np.isfinite(caught.value.state.q).all()
    vector = TipPoseVectorEnv(2, **WILD, on_divergence="raise")
    with pytest.raises(SimulationDiverged, match=r"row \d: "):
        vector.reset(seed=0)
        for _ in range(200):
            vector.step(np.random.default_rng(0).choice([-1.0, 1.0], (2, 3)))


@pytest.mark.parametrize("mode", ["next_step", "same_step"])
def test_other_rows_go_on(mode, same):
    """Rows 0 and 2 are gentle, row 1 is not: the gentle ones are as alone."""
    vector, alone = TipPoseVectorEnv(3, None, mode, **WILD), TipPoseEnv(**WILD)
    vector.reset(seed=3)
    alone.reset(seed=5)
    rng, ends = np.random.default_rng(0), 0
    for _ in range(60):
        action = 0.001 * rng.uniform(-1, 1, (3, 3))
        action[1] = rng.choice([-1.0, 1.0], 3)
        observation, reward, terminated, truncated, info = vector.step(action)
        expected = alone.step(action[2])
        assert same(observation[2], expected[0]) and reward[2] == expected[1] and not terminated[[0, 2]].any() and not truncated.any()
        if terminated[1]:
            ends += 1
            final = info["final_info"] if mode == "same_step" else info
            assert reward[1] == 0.0 and final["diverged"].tolist() == [False, True, False]
            assert isinstance(final["cause"][1], str) and final["_cause"].tolist() == [False, True, False]
    assert ends > 1


def assert_replays(path, observation, cause, same):
    replay = replay_divergence(path)
    assert replay.info["diverged"] and replay.cause == cause == replay.info["cause"]
    assert same(replay.observation, observation)


@pytest.mark.parametrize("kind", [TipPoseEnv, ShapeEnv, ReachEnv])
def test_a_divergence_can_be_lived_through_again(kind, tmp_path, everything, same):
    env = kind(**WILD, randomize=everything, divergence_folder=str(tmp_path / "new"))
    for seed in range(3):
        (observation, _, _, _, info), _ = until_divergence(env, seed)
        assert_replays(info["divergence_file"], observation, info["cause"], same)
    assert len(list((tmp_path / "new").iterdir())) == 3


def test_options_that_are_arrays_are_kept_in_the_file(tmp_path, same):
    options = {**WILD, "tension_limits": np.array([-600.0, 600.0]), "target": {"type": "hold", "tension": np.ones(3)}}
    (observation, _, _, _, info), _ = until_divergence(TipPoseEnv(**options, divergence_folder=str(tmp_path)))
    assert_replays(info["divergence_file"], observation, info["cause"], same)


@pytest.mark.parametrize("mode", ["next_step", "same_step"])
def test_rows_can_be_lived_through_again(mode, tmp_path, everything, same):
    vector = TipPoseVectorEnv(2, 20, mode, **WILD, randomize=everything, divergence_folder=str(tmp_path))
    vector.reset(seed=0)
    rng, files = np.random.default_rng(0), 0
    for _ in range(40):
        observation, _, terminated, _, info = vector.step(rng.choice([-1.0, 1.0], (2, 3)))
        told = info.get("final_info", info)
        for row in np.flatnonzero(terminated):
            last = info["final_obs"][row] if mode == "same_step" else observation[row]
            assert_replays(told["divergence_file"][row], last, told["cause"][row], same)
            files += 1
    assert files > 3


def test_a_file_that_was_cut_is_named(tmp_path):
    (_, _, _, _, info), _ = until_divergence(TipPoseEnv(**WILD, divergence_folder=str(tmp_path)))
    whole, path = Path(info["divergence_file"]).read_bytes(), tmp_path / "cut.npz"
    for size in (0, 100, len(whole) // 2, len(whole) - 1):
        path.write_bytes(whole[:size])
        with pytest.raises(ValueError, match=r"cut\.npz holds no diverged episode: "):
            replay_divergence(path)


@pytest.mark.parametrize(
    "content", ["not JSON", "[]", '{"task": "TipPose"}', '{"task": "Tip", "options": {}, "generator": {}, "cause": ""}'], ids=str
)
def test_a_file_of_something_else_is_named(tmp_path, content):
    path = tmp_path / "other.npz"
    np.savez(path, other=1.0)
    with pytest.raises(ValueError, match=r"other\.npz holds no diverged episode: actions, episode missing"):
        replay_divergence(path)
    np.savez(path, episode=content, actions=np.zeros((1, 3)))
    with pytest.raises(ValueError, match=r"other\.npz holds no diverged episode: "):
        replay_divergence(path)


def test_an_episode_whose_tip_is_too_fast_ends_as_one_that_diverged():
    """At the first step at which it is faster, and with the speed in its cause; without a limit it goes on."""
    options = {"scene": "three_tendon", "fidelity": "fast", "observation": ["tip_twist"]}
    pull = np.array([1.0, -1.0, -1.0], dtype=np.float32)

    def speeds(**more):
        env = TipPoseEnv(**options, **more)
        env.reset(seed=0)
        found = []
        for _ in range(20):
            _, reward, terminated, _, info = env.step(pull)
            found.append(float(np.linalg.norm(env.episodes.arms.reading.tip_twist[0, 3:])))
            if terminated:
                return found, reward, info
        return found, None, None

    free, _, ended = speeds()
    assert ended is None
    limit = 0.5 * (free[0] + max(free))
    found, reward, info = speeds(tip_speed_limit=limit)
    assert found == free[: len(found)] and found[-1] > limit >= max(found[:-1])
    assert reward == 0.0 and info["diverged"] and f"tip_speed_limit is {limit:g}" in info["cause"]


def test_a_row_that_is_too_fast_ends_alone():
    envs = TipPoseVectorEnv(2, scene="three_tendon", fidelity="fast", tip_speed_limit=0.2)
    envs.reset(seed=0)
    pulls = np.array([[1.0, -1.0, -1.0], [-1.0, -1.0, -1.0]], dtype=np.float32)
    ended = np.zeros(2, dtype=bool)
    for _ in range(10):
        ended |= envs.step(pulls)[2]
    assert ended.tolist() == [True, False]


def test_a_speed_limit_raises_where_divergence_does():
    env = TipPoseEnv(scene="three_tendon", fidelity="fast", tip_speed_limit=0.01, on_divergence="raise")
    env.reset(seed=0)
    with pytest.raises(SimulationDiverged, match="tip moved at"):
        for _ in range(5):
            env.step(np.array([1.0, -1.0, -1.0], dtype=np.float32))
