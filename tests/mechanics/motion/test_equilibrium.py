"""Static balance in the kernels: whether one strain becomes another on the way between their coordinates."""

import numpy as np
import pytest

from soft_tendon_env.mechanics.motion.equilibrium import strain_is_continuous
from soft_tendon_env.mechanics.workspace import make_workspace
from soft_tendon_env.model.build import build_model
from soft_tendon_env.scene.file import load_scene


@pytest.mark.parametrize(
    ("start", "end", "continuous"),
    [(0.0, 60.0, True), (-100.0, -280.0, True), (-280.0, -330.0, False)],
    ids=("a pull has one strain", "a push on its branch", "a push past the end of its branch"),
)
def test_a_strain_is_continuous_up_to_the_end_of_its_branch(start, end, continuous):
    arm = build_model(load_scene("paper")).arm
    first = np.eye(10)[0]
    assert strain_is_continuous(arm, start * first, end * first, make_workspace(arm)) is continuous
