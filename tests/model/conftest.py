"""Arms that several files of this folder try."""

import numpy as np
import pytest

from soft_tendon_env.model.model import model_on
from soft_tendon_env.scene.file import load_scene

LENGTH = 0.3  # [m]
BENDING = 5e5 * np.pi * 0.01**4 / 4  # [N m^2]


@pytest.fixture
def bent():
    """An arm with three tendons under its weight: two constant curvatures."""
    modes = [{"strains": ["bend_y", "bend_z"], "order": 0, "span": "rod"}]
    strain = {"type": "explicit", "modes": modes}
    gravity = {"effects.gravity.acceleration": [0.0, 0.0, -9.81]}
    changes = {"strain": strain, **gravity}
    scene = load_scene("three_tendon").replace(changes)
    return model_on(scene, 4)


@pytest.fixture
def fluttering():
    """A hardly damped rod under 1.1 of Beck's load, a force that follows its tip."""
    modes = [{"strains": ["bend_y", "bend_z"], "order": 2, "span": "rod"}]
    beck = 20.05 * BENDING / LENGTH**2
    follower = {
        "strain": {"type": "explicit", "modes": modes},
        "segments.*.damping": 1e-3,
        "effects.tip_load": {"force": [-1.1 * beck, 0.0, 0.0], "frame": "tip"},
    }
    scene = load_scene("three_tendon").replace(follower)
    return model_on(scene, 6)
