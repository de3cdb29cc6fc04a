"""Control periods of rows in PyTorch: gradients of all that comes out, by state and by commands of several parts, against differences."""

import numpy as np
import pytest
import torch

from soft_tendon_env.differentiable import arm_tensors, control_period
from soft_tendon_env.envs.arms import Arms

ROWS = 4


@pytest.fixture
def moving(build, random_state):
    """Rows of a small arm in motion."""
    model = build("three_tendon", {"quadrature.intervals": 4, "integrator.step": 0.01})
    arms = Arms(model, ROWS, 0.02, np.array([0.05, 0.12, 0.3]), np.array([0.1, 0.2]), threads=1)
    q, q_dot = map(np.array, zip(*(random_state(model, seed) for seed in range(ROWS)), strict=True))
    arms.place(np.arange(ROWS), q)
    arms.rows.q_dot[:] = 0.1 * q_dot
    return arms


@pytest.mark.parametrize("out", ["q", "q_dot", "tip_pose", "tip_twist", "backbone_position", "tendon_length", "strain", "strain_rate"])
def test_every_cotangent_goes_back_to_commands_and_state(moving, out):
    """Each alone, by q, q_dot and the commands of two parts."""
    rng = np.random.default_rng(0)
    commands = torch.tensor(rng.uniform(1.0, 3.0, (ROWS, 2, 3)))
    before, guess = arm_tensors(moving), moving.rows.xi.copy()
    weight = torch.tensor(rng.normal(size=getattr(before, out).shape))

    def value(commands, q, q_dot):
        moving.rows.xi[:] = guess
        after = control_period(moving, before._replace(q=q, q_dot=q_dot), commands)
        return (getattr(after, out) * weight).sum()

    inputs = [of.clone().requires_grad_() for of in (commands, before.q, before.q_dot)]
    value(*inputs).backward()
    sizes = [1.0, *(size * torch.tensor(moving.model.coordinate_scale()) for size in (0.1, 1.0))]
    expected, found = [], []
    for i, (own, size) in enumerate(zip(inputs, sizes, strict=True)):
        for _ in range(4):
            way = 1e-3 * size * torch.tensor(rng.normal(size=own.shape))
            beside = [[of.detach() + side * way if of is own else of.detach() for of in inputs] for side in (1.0, -1.0)]
            expected.append(0.5 * (value(*beside[0]) - value(*beside[1])))
            found.append((own.grad * way).sum())
        close = torch.cosine_similarity(torch.stack(found[4 * i :]), torch.stack(expected[4 * i :]), dim=0)
        assert close > 0.99, (i, found[4 * i :], expected[4 * i :])
