"""Machine code follows every source that it was made from: those of a user's effect too, in whatever file they stand."""

import os

import pytest

from soft_tendon_env.compiler.cache_folder import PACKAGE
from soft_tendon_env.compiler.code_digest import code_digest

WALK = """
from soft_tendon_env.mechanics.effects import call
from soft_tendon_env.compiler.compilation import kernel

@kernel
def walk(effects, nodes):
    call(effects.wrench[0], (effects.values, nodes))
"""
EFFECT = """
from typing import NamedTuple
from soft_tendon_env.effects import adds_wrench, kernel
import constants
from helpers import scaled

class Push(NamedTuple):
    size: float

@adds_wrench(Push)
@kernel
def push(effect, nodes):
    nodes.wrench[0] += scaled(effect.size) + constants.MORE
"""
HELPERS = """
from soft_tendon_env.compiler.compilation import kernel
FACTOR = 2.0

@kernel(inline=True)
def scaled(x):
    return FACTOR * x
"""
MAIN = """
import numpy as np
from soft_tendon_env.mechanics.effects import Nodes, make_table, run_of_kind
from walking import walk
from pushing import Push
nodes = Nodes(1, 0.0, *(np.zeros(1) for _ in Nodes._fields[2:]))
walk(make_table([Push(3.0)], [np.zeros(0)]), nodes)
print(nodes.wrench[0], sum(run_of_kind.stats.cache_misses.values()))
"""


def beside_the_package(folder):
    """Variables under which Python finds modules in the folder as they are now."""
    return {"PYTHONPATH": os.pathsep.join([str(PACKAGE.parent), str(folder)]), "PYTHONDONTWRITEBYTECODE": "1"}


@pytest.fixture
def project(run, tmp_path):
    """project(name=text, ...): writes modules of a user's, runs MAIN, and gives what it prints."""
    (tmp_path / "user").mkdir()

    def write_and_run(main=MAIN, **modules):
        for name, text in modules.items():
            (tmp_path / "user" / f"{name}.py").write_text(text)
        return run(main, **beside_the_package(tmp_path / "user")).stdout

    write_and_run(main="", walking=WALK, pushing=EFFECT, helpers=HELPERS, constants="MORE = 1.0\n")
    return write_and_run


def test_what_has_not_changed_is_loaded(project):
    assert [project(), project()] == ["7.0 1\n", "7.0 0\n"]


@pytest.mark.parametrize(
    ("change", "result"),
    [
        pytest.param({"pushing": EFFECT.replace("wrench[0] +=", "wrench[0] -=")}, "-7.0 1\n", marks=pytest.mark.slow),
        ({"helpers": HELPERS.replace("FACTOR * x", "FACTOR + x")}, "6.0 1\n"),
        pytest.param({"helpers": HELPERS.replace("FACTOR = 2.0", "FACTOR = 4.0")}, "13.0 1\n", marks=pytest.mark.slow),
        pytest.param({"constants": "MORE = 5.0\n"}, "11.0 1\n", marks=pytest.mark.slow),
    ],
    ids=["kernel", "helper", "global", "attribute of a module"],
)
def test_a_changed_effect_is_compiled_again(project, change, result):
    assert project() == "7.0 1\n"
    assert project(**change) == result
    assert project(pushing=EFFECT, helpers=HELPERS, constants="MORE = 1.0\n") == "7.0 1\n"


IN_SCRIPT = EFFECT + MAIN.replace("from pushing import Push\n", "")


@pytest.mark.slow
def test_the_effect_of_a_script_is_kept_and_followed(project):
    """Its class is of `__main__`, which pickles would copy."""
    assert [project(IN_SCRIPT), project(IN_SCRIPT)] == ["7.0 1\n", "7.0 0\n"]
    assert project(IN_SCRIPT.replace("wrench[0] +=", "wrench[0] -=")) == "-7.0 1\n"
    assert project() == "7.0 1\n", "another class of the same name"
    assert [project(), project(IN_SCRIPT.replace("wrench[0] +=", "wrench[0] -="))] == ["7.0 0\n", "-7.0 0\n"]


def typed(text):
    """The script as if it were typed in: its functions have no file."""
    return f"exec(compile({text!r}, '<stdin>', 'exec'), globals())"


@pytest.mark.slow
def test_effects_that_are_typed_in_are_followed_by_their_code(project):
    constant = IN_SCRIPT.replace("constants.MORE", "1.0")
    assert project(typed(constant)) == "7.0 1\n"
    assert project(typed(constant)).startswith("7.0 ")
    assert project(typed(constant.replace("+ 1.0", "+ 2.0"))) == "8.0 1\n"
    assert project(typed(constant.replace("wrench[0] +=", "wrench[0] -="))) == "-7.0 1\n"


def test_digests_follow_closures_defaults_and_nested_functions():
    def made(factor, default=0.0, inner=1.0):
        def function(x, y=default):
            return factor * x + y + (lambda z: z * inner)(x)

        return function

    digests = [code_digest(made(*values)) for values in ((1.0,), (2.0,), (1.0, 3.0), (1.0, 0.0, 2.0), (1.0,))]
    assert len(set(digests)) == 4 and digests[0] == digests[-1]


TWO_VERSIONS = """
import numpy as np
import soft_tendon_env as ste
import lift
model = ste.build_model(ste.load_scene("three_tendon").replace({"effects.lift.force": 0.1, "quadrature.intervals": 4}))
q = np.zeros(model.coordinate_count)
print(*model.terms(q, q).external_force.round(6))
"""
LIFT = """
from typing import NamedTuple
from soft_tendon_env.effects import Effect, adds_wrench, kernel, register_effect
from soft_tendon_env.mechanics.algebra.lanes import LANES

class Lifted(NamedTuple):
    force: float

@register_effect("lift")
class Lift(Effect):
    force: float
    def parameters(self, rod):
        return Lifted(self.force)

@adds_wrench(Lifted)
@kernel
def lift_wrench(lift, nodes):
    nodes.wrench[(nodes.packs - 1) * 6 * LANES + 5 * LANES + LANES - 1] += FACTOR * lift.force
"""


@pytest.mark.slow
def test_two_versions_of_an_effect_give_their_own_results_from_one_folder(run, tmp_path):
    """With all of the package's kernels between the scene and the effect: the force on the coordinates is in proportion."""
    forces = []
    for factor in (1.0, 2.0, 1.0):
        (tmp_path / "lift.py").write_text(LIFT.replace("FACTOR", str(factor)))
        printed = run(TWO_VERSIONS, **beside_the_package(tmp_path)).stdout
        forces.append([float(value) for value in printed.split()])
    assert any(forces[0]) and forces[2] == forces[0]
    assert forces[1] == pytest.approx([2.0 * value for value in forces[0]], abs=2e-6)
