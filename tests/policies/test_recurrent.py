"""A policy that remembers: its memory goes with the state, row by row, and begins anew with an
episode."""

import gymnasium as gym
import numpy as np
import pytest

from soft_tendon_env.policies.architecture import read_architecture
from soft_tendon_env.policies.weights import build_network

SPACES = gym.spaces.Box(-1.0, 1.0, (6,), np.float32), gym.spaces.Box(-1.0, 1.0, (2,), np.float32)
SIZES = {"net_arch": [16], "memory": 5, "fine": 10.0, "posture": 2}
SEEN = 2 * 6 + 5  # entries, their fine copies and the memory
SHAPES = {
    "gate.weight": (5, SEEN),
    "gate.bias": (5,),
    "candidate.weight": (5, SEEN),
    "candidate.bias": (5,),
    "mlp_extractor.policy_net.0.weight": (16, SEEN),
    "mlp_extractor.policy_net.0.bias": (16,),
    "way.weight": (16, 2 * (6 - 2)),
    "gain.weight": (2, 16),
    "action_net.weight": (2, 16),
    "action_net.bias": (2,),
}
BEGINS = np.ones(3, dtype=bool)
GOES_ON = np.zeros(3, dtype=bool)


def draw_arrays():
    draw = np.random.default_rng(0)
    return {name: draw.normal(0.0, 0.3, shape).astype(np.float32) for name, shape in SHAPES.items()}


@pytest.fixture(scope="module")
def policy():
    return build_network(read_architecture("APG", SIZES), draw_arrays(), *SPACES)


@pytest.fixture(scope="module")
def seen():
    rng = np.random.default_rng(0)
    return rng.uniform(-1.0, 1.0, (4, 3, 6)).astype(np.float32)


def played(policy, seen, starts):
    """Actions (periods, ..) of a policy that gets its state back."""
    actions = []
    state = None
    for observation, start in zip(seen, starts, strict=True):
        action, state = policy.predict(observation, state, start)
        actions.append(action)
    return np.array(actions)


def test_rows_act_as_they_would_alone(policy, seen):
    together = played(policy, seen, [BEGINS, *[GOES_ON] * 3])
    for row in range(3):
        alone = played(policy, seen[:, row], [BEGINS[:1], *[GOES_ON[:1]] * 3])
        np.testing.assert_allclose(together[:, row], alone, atol=1e-6)


def test_the_memory_matters_and_begins_anew_where_an_episode_does(policy, seen):
    once = played(policy, seen, [BEGINS, GOES_ON, GOES_ON, GOES_ON])
    second_row_begins = np.array([False, True, False])
    again = played(policy, seen, [BEGINS, GOES_ON, second_row_begins, GOES_ON])
    fresh = played(policy, seen[2:], [BEGINS, GOES_ON])
    second_row_afterwards = again[2:, 1]
    second_row_fresh = fresh[:, 1]
    second_row_at_once = once[2:, 1]
    np.testing.assert_allclose(second_row_afterwards, second_row_fresh, atol=1e-6)
    others = [0, 2]
    np.testing.assert_array_equal(again[:, others], once[:, others])
    difference = np.abs(second_row_afterwards - second_row_at_once)
    assert (difference > 1e-6).any()


def test_lost_states_are_told(policy, seen):
    with pytest.warns(UserWarning, match="without the state of what the policy remembers"):
        for _ in range(11):
            policy.predict(seen[0])


def test_a_state_of_other_rows_is_refused(policy, seen):
    _, state = policy.predict(seen[0], None, BEGINS)
    with pytest.raises(ValueError, match=r"for these rows, of shape \(1, 5\), not \(3, 5\)"):
        policy.predict(seen[0, 0], state)


@pytest.mark.parametrize("given", [{"memory": -1}, {"posture": 6}, {"posture": -2}])
def test_sizes_that_cannot_be_are_refused(given):
    with pytest.raises(
        ValueError,
        match="they should be at least 0, and posture less than the size of an observation, 6",
    ):
        build_network(read_architecture("APG", given), {}, *SPACES)


def test_where_nothing_is_away_from_rest_only_layers_without_gains_act():
    """Gains by which the way to the target is multiplied add nothing where there is none."""
    arrays = draw_arrays()
    architecture = read_architecture("APG", SIZES)
    before = build_network(architecture, arrays, *SPACES)
    greater_gain = arrays["gain.weight"] + np.float32(1.0)
    changed = {**arrays, "gain.weight": greater_gain}
    after = build_network(architecture, changed, *SPACES)
    at_rest = np.array([[0.3, -0.2, 0.0, 0.0, 0.0, 0.0]], dtype=np.float32)
    memory = np.zeros((1, 5), dtype=np.float32)
    action_before, _ = before.actor(at_rest, memory)
    action_after, _ = after.actor(at_rest, memory)
    np.testing.assert_array_equal(action_before, action_after)
    moved = at_rest + np.float32(0.1)
    action_before, _ = before.actor(moved, memory)
    action_after, _ = after.actor(moved, memory)
    assert not np.allclose(action_before, action_after)
