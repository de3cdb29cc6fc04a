"""Rollouts with known numbers."""

import numpy as np
import pytest

from soft_tendon_env.drawing.shapes import backbones
from soft_tendon_env.recording.rollout import Rollout

PERIOD = 0.02


def strain_of(model, bend):
    """Strains (samples, points, 6) that bend (samples,) [1/m] about y and z."""
    strain = np.tile(model.grid.unpacked(model.arm.rod.reference_strain), (len(bend), 1, 1))
    strain[..., 1] += bend[:, None]
    strain[..., 2] += 0.5 * bend[:, None]
    return strain


@pytest.fixture(scope="session")
def model(build):
    return build("three_tendon")


@pytest.fixture
def rollout(model):
    """rollout(samples, seed): a bending arm with random tensions, a target, errors and rewards."""

    def make(samples=7, seed=0):
        rng = np.random.default_rng(seed)
        strain = strain_of(model, np.linspace(0.0, 3.0, samples))
        tip = backbones(model, strain, model.grid.breakpoints[-1:])[:, 0]
        return Rollout(
            model,
            PERIOD,
            strain,
            tension=rng.uniform(0.0, 20.0, (samples, model.tendon_count)),
            tip_pose=tip,
            target_pose=np.tile(tip[-1], (samples, 1, 1)),
            target_backbone=np.tile(
                backbones(model, strain[-1:], model.grid.breakpoints)[..., :3, 3], (samples, 1, 1)
            ),
            action=rng.uniform(-1.0, 1.0, (samples, 2)),
            scalars={
                "position_error": rng.random(samples),
                "reward": rng.random(samples),
                "substeps": np.arange(float(samples)),
            },
            title=f"episode {seed}",
        )

    return make
