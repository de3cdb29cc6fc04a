"""The rate limit is the arm's: whatever policy drives it, commands change by no more in a period;
controllers know it, and agents whose increments are smaller act as without it."""

import gymnasium as gym
import numpy as np
import pytest

from soft_tendon_env.control.catalogue import controllers_of
from soft_tendon_env.envs import IDS, Options
from soft_tendon_env.policies import load_policy, policy_options
from soft_tendon_env.policies.agent import shipped, shipped_as, trained_folder

SMALL = {"scene": "three_tendon", "fidelity": "fast", "target": "random", "difficulty": "hard"}
RATE = 4.0  # [N/s], of tensions up to 5 N
PERIODS = 12
ROUND_OFF = 1e-12
# of what is asked for, in single precision
SINGLE_PRECISION = 1e-6
CONTROLLERS = [
    (task, name) for task in ("TipPose", "Shape", "Reach") for name in controllers_of(task)
]
AGENTS = [
    # one agent of each task is quick; the kernels of water and obstacles are for two others alone
    pytest.param(task, name, marks=() if name == shipped_as("agent", task) else pytest.mark.slow)
    for task in ("TipPose", "Shape", "Reach")
    for name in shipped()
    if (trained_folder() / name / task / "config.json").is_file()
]


def commands(name, task, given, periods=PERIODS):
    """Commands (1 + periods, n_a) of an episode, and the tensions that the policy remembers."""
    options = {**given, **policy_options(name, task, given)}
    if task == "Reach":
        options = {k: v for k, v in options.items() if k not in ("target", "difficulty")}
    env = gym.make(IDS[task], **options)
    policy = load_policy(name, env)
    observation, _ = env.reset(seed=1)
    actuation = env.unwrapped.episodes.actuation
    course = [actuation.command[0].copy()]
    remembered = []
    state = None
    for _ in range(periods):
        action, state = policy.predict(observation, state)
        observation, _, terminated, _, _ = env.step(action)
        course.append(actuation.command[0].copy())
        remembered.append(state)
        if terminated:
            break
    return np.array(course), remembered


@pytest.mark.parametrize(("task", "name"), CONTROLLERS)
def test_no_controller_changes_commands_faster(task, name):
    """And each remembers what was sent, not what it would have liked."""
    course, remembered = commands(name, task, {**SMALL, "rate_limit": RATE})
    most = RATE * 0.02
    changes = np.abs(np.diff(course, axis=0))
    assert changes.max() <= most * (1.0 + ROUND_OFF)
    asked = np.array([rows[0].tension for rows in remembered])
    np.testing.assert_allclose(asked, course[1:], atol=SINGLE_PRECISION)


@pytest.mark.parametrize("name", ["predictive", "tracking", "filtered:predictive"])
def test_controllers_that_know_the_limit_ask_for_no_more(name):
    """The limit acts, and what they decide is what they get."""
    course, remembered = commands(name, "TipPose", {**SMALL, "rate_limit": RATE})
    most = RATE * 0.02
    decided = np.array([rows[0].decision.tension for rows in remembered])
    np.testing.assert_allclose(decided, course[1:], atol=SINGLE_PRECISION)
    assert np.abs(np.diff(course, axis=0)).max() == pytest.approx(most)


@pytest.mark.parametrize(("task", "name"), AGENTS)
def test_agents_act_as_before_within_their_increments_and_never_faster(task, name):
    options = Options.parse(policy_options(name, task, {}), "options")
    if options.action == "increment":
        free, _ = commands(name, task, {})
        within, _ = commands(name, task, {"rate_limit": options.tension_rate})
        np.testing.assert_array_equal(free, within)
    tighter = 0.3 * options.tension_rate
    held, _ = commands(name, task, {"rate_limit": tighter})
    changes = np.abs(np.diff(held, axis=0))
    assert changes.max() == pytest.approx(tighter * 0.02, rel=1e-9)


def test_rows_have_the_limit_too():
    envs = gym.make_vec(
        IDS["TipPose"], num_envs=3, threads=1, action="tension", rate_limit=RATE, **SMALL
    )
    envs.reset(seed=0)
    rng = np.random.default_rng(0)
    before = envs.unwrapped.episodes.actuation.command.copy()
    for _ in range(5):
        envs.step(rng.uniform(-1.0, 1.0, envs.action_space.shape).astype(np.float32))
        after = envs.unwrapped.episodes.actuation.command.copy()
        difference = after - before
        assert np.abs(difference).max() <= RATE * 0.02 * (1.0 + ROUND_OFF)
        before = after


def test_elastic_tendons_that_are_cut_off_have_the_tension_that_they_get():
    """What a policy remembers is that of its displacement, by the springs."""
    stiffness = 5e3
    springs = {
        "scene": "three_tendon",
        "effects.tendon_elasticity": {
            "stiffness": stiffness,
            "displacement_limits": [-0.03, 0.05],
        },
    }
    given = {**SMALL, "scene": springs, "rate_limit": RATE}
    course, remembered = commands("predictive", "TipPose", given, 3)
    last = remembered[0][0]
    decided = last.decision.tension
    cut_off = decided > 0.5
    assert cut_off.any()
    # the springs of tendons that should have been pulled further lack tension
    assert (last.tension[cut_off] < decided[cut_off]).all()
    most = RATE * 0.02 * 0.08 / 5.0  # [m], as a share of the range of displacements
    assert np.abs(np.diff(course, axis=0)).max() == pytest.approx(most, rel=1e-9)
