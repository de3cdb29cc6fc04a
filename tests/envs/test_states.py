"""States, goals and targets of a user's own: options of `reset`."""

from dataclasses import replace

import numpy as np
import pytest
from gymnasium.error import ResetNeeded

from soft_tendon_env import ConfigurationError, Simulation, build_model, load_scene
from soft_tendon_env.envs import ReachEnv, ReachVectorEnv, ShapeEnv, TipPoseEnv, TipPoseVectorEnv

SMALL = {"scene": "three_tendon", "fidelity": "fast"}
HANGING = {"scene": "three_tendon", "effects.gravity.acceleration": [0.0, 0.0, -9.81]}
LATE = {**HANGING, "effects.actuators": {"time_constant": 0.03, "delay": 0.013}}
TENSION = [4.0, 1.0, 0.0]
POSE = np.array(
    [[0.0, -1.0, 0.0, 0.2], [1.0, 0.0, 0.0, 0.1], [0.0, 0.0, 1.0, 0.0], [0.0, 0.0, 0.0, 1.0]]
)


def bent(env, tension=TENSION, seconds=0.1):
    """A state on the way to where tensions bend the arm of an environment."""
    simulation = Simulation(env.unwrapped.model)
    simulation.step(tension, seconds)
    return simulation.state


@pytest.mark.parametrize(
    "scene", ["three_tendon", HANGING, LATE], ids=["plain", "loaded", "actuators"]
)
def test_episodes_begin_in_a_state_and_go_on_as_a_simulation_does(scene, same):
    """A row is the single environment."""
    options = {"scene": scene, "fidelity": "fast", "action": "tension"}
    env = TipPoseEnv(**options)
    rows = TipPoseVectorEnv(**options, num_envs=3)
    state = bent(env)
    first, _ = env.reset(seed=5, options={"state": state})
    found, _ = rows.reset(seed=4, options={"state": [None, state, None]})
    usual, _ = TipPoseEnv(**options).reset(seed=4)
    assert same(found[1], first)
    assert same(found[0], usual)
    assert not same(found[2], found[1])
    assert same([*vars(env.state).values()], [*vars(state).values()])
    assert same([*vars(rows.state[1]).values()], [*vars(state).values()])
    simulation = Simulation(env.model, state)
    np.testing.assert_allclose(
        env.episodes.arms.reading.tip_pose[0], simulation.tip_pose, atol=1e-12
    )
    for step in range(2):
        simulation.step(
            [12.0, 6.0, 3.0] @ np.diag(env.episodes.limits[:, 1] / 12.0), env.episodes.period
        )
        observation = env.step([1.0, 0.0, -0.5])[0]
        assert same(rows.step(np.tile([1.0, 0.0, -0.5], (3, 1)))[0][1], observation)
        np.testing.assert_allclose(
            env.state.q, simulation.state.q, atol=1e-9 * np.abs(state.q).max(), err_msg=str(step)
        )


def test_goals_and_targets_are_of_one_episode(same):
    env = ReachEnv(**SMALL)
    rows = ReachVectorEnv(3, 2, "same_step", **SMALL)
    usual = [ReachEnv(**SMALL).reset(seed=2 + row)[0]["desired_goal"] for row in range(3)]
    for goal in (
        [0.2, 0.1, 0],
        (0.2, 0.1, 0.0),
        np.array([0.2, 0.1, 0.0], dtype=np.float32),
        POSE,
        POSE.tolist(),
    ):
        np.testing.assert_allclose(
            env.reset(options={"goal": goal})[0]["desired_goal"], [0.2, 0.1, 0.0], atol=1e-7
        )
    hold = {"type": "hold", "position": [0.1, 0.2, 0.05]}
    np.testing.assert_allclose(
        ReachEnv(**SMALL, target=hold).reset()[0]["desired_goal"], hold["position"], atol=1e-7
    )
    each = np.array([[0.2, 0.1, 0.0], [0.0, 0.2, 0.1], [0.1, 0.0, 0.2]])
    np.testing.assert_allclose(
        rows.reset(seed=2, options={"goal": each})[0]["desired_goal"], each, atol=1e-7
    )
    some, _ = rows.reset(
        seed=2, options={"goal": [None, each[1], None], "target": [None, None, hold]}
    )
    np.testing.assert_allclose(
        some["desired_goal"], [usual[0], each[1], hold["position"]], atol=1e-7
    )
    ended = [
        rows.step(np.zeros((3, 3)))[0]["desired_goal"] for _ in range(2)
    ]  # the second resets, with usual goals
    assert same(ended[0], some["desired_goal"])
    assert not (ended[1] == ended[0]).all(axis=1).any()
    tip = TipPoseEnv(**SMALL)
    tip.reset(options={"goal": POSE})
    assert (tip.episodes.target_pose[0] == POSE).all()
    assert (tip.target_at([3.0]).tip_pose == POSE).all()
    tip.reset(seed=1, options={"target": "steps"})
    expected = TipPoseEnv(**SMALL, target="steps")
    expected.reset(seed=1)
    assert same(tip.target_at([0.0, 5.0]).tip_pose, expected.target_at([0.0, 5.0]).tip_pose)


def test_options_are_of_the_rows_that_are_reset(same):
    rows = ReachVectorEnv(3, None, "disabled", **SMALL)
    before, _ = rows.reset(seed=0)
    goals = np.array(
        [[0.2, 0.1, 0.0], [0.0, 0.2, 0.1], [9.0, 9.0, 9.0]]
    )  # the last is none, of a row that goes on
    mask = np.array([True, False, False])
    after, _ = rows.reset(
        options={"reset_mask": mask, "goal": [goals[0], goals[1], None], "episode_steps": [2, 1, 1]}
    )
    np.testing.assert_allclose(
        after["desired_goal"], [goals[0], *before["desired_goal"][1:]], atol=1e-7
    )
    assert [rows.step(np.zeros((3, 3)))[3].tolist() for _ in range(2)] == [
        [False] * 3,
        [True, False, False],
    ]


@pytest.mark.parametrize("scene", ["three_tendon", LATE], ids=["plain", "actuators"])
def test_the_state_can_be_set_in_mid_episode(scene, same):
    """Noise, past observations and commands on their way stay as they are; right after a reset it
    is as the option of reset."""
    options = {"history": 2, "randomize": {"latency": 0.03, "noise": {"position": 1e-3}}}
    env = TipPoseEnv(scene=scene, fidelity="fast", **options)
    twin = TipPoseEnv(scene=scene, fidelity="fast", **options)
    rng = np.random.default_rng(0)
    actions = rng.uniform(-1.0, 1.0, (8, 3))
    for each in (env, twin):
        each.reset(seed=1)
        for action in actions[:4]:
            each.step(action)
    elsewhere = bent(env)
    before = env.state
    env.state = elsewhere
    assert same([*vars(env.state).values()], [*vars(elsewhere).values()])
    reading = env.episodes.arms.reading
    observed = env.episodes.layout.values(env.episodes.observation())
    np.testing.assert_allclose(
        reading.tip_pose[0], Simulation(env.model, elsewhere).tip_pose, atol=1e-12
    )
    np.testing.assert_allclose(observed["coordinates"][0], elsewhere.q, rtol=1e-5)
    env.state = before
    assert same(env.episodes.observation(), twin.episodes.observation())
    for action in actions[4:]:
        assert same(env.step(action), twin.step(action))
    begun, _ = twin.reset(seed=7, options={"state": elsewhere})
    env.reset(seed=7)
    env.state = elsewhere
    assert same(env.episodes.observation()[0], begun)
    for action in actions:
        assert same(env.step(action), twin.step(action))


def test_another_target_is_followed_from_now_on(same):
    """In rows as in single environments: from its beginning, in later episodes too; the other rows
    go on."""
    options = {**SMALL, "preview": [0.1], "history": 1}
    rows = TipPoseVectorEnv(2, 12, **options)
    single = [TipPoseEnv(**options) for _ in range(2)]
    rows.reset(seed=0)
    for seed, env in enumerate(single):
        env.reset(seed=seed)
    for step in range(30):
        if step == 5:
            rows.set_target("steps", rows=1)
            single[1].set_target("steps")
            assert same(
                single[1].target_at([0.1 + 2.0 * k for k in range(6)]).tip_pose[0],
                single[1].episodes.target_pose[0],
            )
        observation = rows.step(np.full((2, 3), 0.1))[0]
        for row, env in enumerate(single):
            if step in (12, 25):
                found = env.reset()[0]
            else:
                found = env.step(np.full(3, 0.1))[0]
            assert same(observation[row], found)
    for target in ({"type": "hold", "pose": POSE}, None):
        single[0].set_target(target)
        assert (single[0].episodes.target_pose[0] == POSE).all() == (target is not None)
        single[0].reset(seed=3)
        assert (single[0].episodes.target_pose[0] == POSE).all() == (target is not None)
    assert same(single[0].reset(seed=3)[0], TipPoseEnv(**options).reset(seed=3)[0])


@pytest.mark.parametrize(
    ("kind", "target"),
    [
        (TipPoseEnv, "hald"),
        (ShapeEnv, {"type": "circle"}),
        (TipPoseEnv, {"type": "hold", "tension": [1.0]}),
    ],
)
def test_another_target_is_refused_as_one_of_the_start(kind, target, same):
    env = kind(**SMALL)
    twin = kind(**SMALL)
    said = []
    for each in (env, twin):
        each.reset(seed=0)
    for refuse in (lambda: env.set_target(target), lambda: kind(**SMALL, target=target)):
        with pytest.raises(ConfigurationError) as caught:
            refuse()
        said.append(str(caught.value))
    assert said[0] == said[1]
    assert same(env.step(np.zeros(3)), twin.step(np.zeros(3)))
    assert same(env.reset(), twin.reset())


REFUSED = [
    (
        TipPoseEnv,
        {"gaol": 1},
        "options: gaol is no option of reset: did you mean 'goal'.*"
        " valid: episode_steps, goal, state, target",
    ),
    (TipPoseEnv, {"reset_mask": [True]}, "options: reset_mask is no option of reset"),
    (TipPoseEnv, "goal", "options should be a dict or None, not str"),
    (
        TipPoseEnv,
        {"goal": [0.1, 0.2, 0.3]},
        "target.position is a position alone: TipPose needs a pose, 4 x 4",
    ),
    (
        TipPoseEnv,
        {"goal": 2.0 * POSE},
        r"options: goal.pose is .* it should be a homogeneous matrix",
    ),
    (TipPoseEnv, {"target": "hald"}, "options: target.type is 'hald': did you mean 'hold'"),
    (
        TipPoseEnv,
        {"target": {"type": "hold", "tension": [1.0]}},
        "target.tension has 1 entries: it should have one per tendon, 3",
    ),
    (TipPoseEnv, {"state": np.zeros(3)}, "options: state is .*: it should be an instance of State"),
    (
        ShapeEnv,
        {"goal": POSE},
        "target is 'hold', which is a pose alone: Shape needs one that is made of tensions",
    ),
    (
        ReachEnv,
        {"goal": [0.1, 0.2]},
        "options: goal is .*: it should be a position of three numbers .m., or a pose, 4 x 4",
    ),
    (
        ReachEnv,
        {"goal": [0.1, 0.2, np.nan]},
        r"options: goal.position\[2\] is nan: it should be a finite number",
    ),
    (
        ReachEnv,
        {"goal": ["a", "b", "c"]},
        r"options: goal.position\[0\] is 'a': it should be a valid number",
    ),
    (
        ReachEnv,
        {"goal": [200.0, 100.0, 0.0]},
        r"target.position is at \[200.0, 100.0, 0.0\] m: goals should lie within ±0.6 m, 2 lengths",
    ),
    (
        ReachVectorEnv,
        {"goal": [[0.1, 0.0, 0.1]]},
        "options: goal should have one value per row, 2, each None for what is usual",
    ),
    (
        ReachVectorEnv,
        {"goal": [None, [0.1]]},
        "options of row 1: goal is .*: it should be a position of three numbers",
    ),
    (
        ReachVectorEnv,
        {"state": [None, "bent"]},
        "options of row 1: state is 'bent': it should be an instance of State",
    ),
    (ReachVectorEnv, {"gaol": 1}, "valid: episode_steps, goal, reset_mask, state, target"),
]


@pytest.mark.parametrize(("made", "options", "message"), REFUSED)
def test_bad_options_are_refused_before_anything_changes(made, options, message, same):
    env, twin = (
        made(num_envs=2, **SMALL) if made is ReachVectorEnv else made(**SMALL) for _ in range(2)
    )
    action = np.full(env.action_space.shape, 0.4)
    for each in (env, twin):
        each.reset(seed=1)
        each.step(action)
    with pytest.raises((ValueError, TypeError), match=message):
        env.reset(seed=3, options=options)
    assert same(env.step(action)[:3], twin.step(action)[:3])
    assert same(env.reset()[0], twin.reset()[0])


def test_states_that_are_not_the_arms_are_refused_before_anything_changes(same):
    env = TipPoseEnv(**SMALL)
    twin = TipPoseEnv(**SMALL)
    late = TipPoseEnv(**{**SMALL, "scene": LATE})
    start = bent(env)
    bad = {
        "state.q should have shape": Simulation(build_model(load_scene("helical"))).state,
        "state.q should be finite": replace(start, q=start.q * np.nan),
        "state.strain should be the strain at state.q": replace(start, q=start.q + 1.0),
        "state.step should be": replace(start, step=0.0),
    }
    for each in (env, twin):
        each.reset(seed=0)
        each.step(np.ones(3))
    for message, state in bad.items():
        with pytest.raises(ValueError, match=message):
            env.reset(seed=4, options={"state": state})
        with pytest.raises(ValueError, match=message):
            env.state = state
    with pytest.raises(ValueError, match="this state is of .*"):
        late.reset(options={"state": bent(TipPoseEnv(**{**SMALL, "scene": HANGING}))})
    with pytest.raises(ResetNeeded, match="state was used before reset"):
        late.state = start
    assert same(env.step(np.zeros(3)), twin.step(np.zeros(3)))
