"""Kernels that only arms with effects come to: which are compiled for which arm, and with which arguments."""

import os

import numpy as np
import pytest
from numba.core.errors import TypingError

from soft_tendon_env.compiler.compilation import kernel
from soft_tendon_env.mechanics.late_kernels import LATE, call_late
from soft_tendon_env.mechanics.terms.external_forces import external_force, move_base

SCRIPT = """
import numpy as np
import soft_tendon_env as ste
from soft_tendon_env.mechanics.late_kernels import LATE, _KERNELS
for changes in ({"effects": {}}, {"effects.gravity.acceleration": [0.0, 0.0, -9.81]}):
    model = ste.build_model(ste.load_scene("three_tendon").replace(changes))
    ste.Simulation(model).step(np.zeros(3), 0.01)
    print([name for name in LATE if _KERNELS[name].kernel.overloads])
"""


def test_an_arm_needs_the_machine_code_of_its_effects_alone(run):
    expected = "[]\n['external_force', 'add_implicit']\n"
    here = {name: os.environ.get(name) for name in ("NUMBA_CACHE_DIR", "XDG_CACHE_HOME")}
    assert run(SCRIPT, **here).stdout == expected, "compiled or from the cache"


@pytest.mark.no_jit
def test_an_arm_has_the_addresses_of_its_own_type(build):
    gravity = {"effects.gravity.acceleration": [0.0, 0.0, -9.81]}
    arm, other = build("four_tendon", gravity).arm, build("three_tendon", {**gravity, "effects.moving_base.velocity": [0.1, 0.0, 0.0]}).arm
    assert not build("four_tendon").arm.effects.late.any()
    if hasattr(move_base, "overloads"):
        assert [name for name, address in zip(LATE, arm.effects.late, strict=True) if address] == ["external_force", "add_implicit"]
        swapped = arm.replaced(effects=other.effects)
        assert swapped.effects.late[[*LATE].index("move_base")] and not arm.effects.late[[*LATE].index("move_base")]


@pytest.mark.skipif(not hasattr(move_base, "overloads"), reason="nothing is compiled")
def test_a_call_with_other_arguments_than_it_is_compiled_for_is_refused(build):
    arm = build("four_tendon", {"effects.gravity.acceleration": [0.0, 0.0, -9.81]}).arm

    @kernel
    def calls(arm, work):
        call_late(external_force, arm.effects.late, (arm, work))

    with pytest.raises(TypingError, match="external_force is compiled for arguments of the types"):
        calls(arm, np.zeros(1))
