"""Machine code follows every source that it was made from: those of a user's effect too, in whatever file they stand."""

import os

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


def test_a_changed_function_in_another_file_compiles_the_effect_again(run, tmp_path):
    modules = {"walking": WALK, "pushing": EFFECT, "helpers": HELPERS, "constants": "MORE = 1.0\n"}
    variables = {"PYTHONPATH": os.pathsep.join([str(PACKAGE.parent), str(tmp_path)]), "PYTHONDONTWRITEBYTECODE": "1"}

    def printed(**changed):
        for name, text in {**modules, **changed}.items():
            (tmp_path / f"{name}.py").write_text(text)
        return run(MAIN, **variables).stdout

    assert [printed(), printed()] == ["7.0 1\n", "7.0 0\n"]
    assert printed(helpers=HELPERS.replace("FACTOR * x", "FACTOR + x")) == "6.0 1\n"
    assert printed() == "7.0 1\n"


def test_digests_follow_closures_defaults_and_nested_functions():
    def made(factor, default=0.0, inner=1.0):
        def function(x, y=default):
            return factor * x + y + (lambda z: z * inner)(x)

        return function

    digests = [code_digest(made(*values)) for values in ((1.0,), (2.0,), (1.0, 3.0), (1.0, 0.0, 2.0), (1.0,))]
    assert len(set(digests)) == 4 and digests[0] == digests[-1]
