"""Kernels that are compiled when they are first called: when that is, from every thread and process, and what a failure says."""

import os

CALLER = """
import threading
import time
import numpy as np
from soft_tendon_env.mechanics import late_binding
from soft_tendon_env.mechanics.algebra.linear import copy
from soft_tendon_env.mechanics.late_binding import call_late
from soft_tendon_env.compiler.compilation import kernel

@kernel
def copied(now, source, out):
    if now:
        call_late(copy, (source, out))
    return now

def compiled():
    return len(copy.overloads)

source, out = np.arange(3.0), np.zeros(3)
"""

CALLS = """
print(copied(False, source, out), compiled(), out)
print(copied(True, source, out), compiled(), out)
print(copied(True, 2.0 * source, out), compiled(), out)
"""


def test_a_kernel_is_compiled_when_it_is_first_called(run):
    for _ in range(2):  # compiled, and from the cache
        assert run(CALLER + CALLS).stdout == "False 0 [0. 0. 0.]\nTrue 1 [0. 1. 2.]\nTrue 1 [0. 2. 4.]\n"


def test_without_the_compiler_it_is_a_call(run):
    plain = CALLER.replace("len(copy.overloads)", "0")
    assert run(plain + CALLS, NUMBA_DISABLE_JIT="1").stdout == "False 0 [0. 0. 0.]\nTrue 0 [0. 1. 2.]\nTrue 0 [0. 2. 4.]\n"


def test_threads_may_all_be_the_first(run):
    threads = """
copied(False, source, out)
outs = np.zeros((8, 3))
threads = [threading.Thread(target=copied, args=(True, source, own)) for own in outs]
[thread.start() for thread in threads]
[thread.join() for thread in threads]
print(compiled(), (outs == source).all())
"""
    assert run(CALLER + threads).stdout == "1 True\n"


FAILS = """
copied(False, source, out)
def address(late):
    raise {0}
late_binding.Late.address = address
try:
    try:
        copied(True, source, out)
    except RuntimeError as error:
        print(error)
    print(out)
    time.sleep({1})
except KeyboardInterrupt:
    print("interrupted")
"""


def test_what_cannot_be_compiled_is_an_error_where_it_was_called(run):
    process = run(CALLER + FAILS.format("MemoryError('none left')", 0.0))
    assert process.stdout == "copy could not be compiled\n[0. 0. 0.]\n"
    assert "none left" in process.stderr


def test_an_interrupt_while_it_compiles_arrives(run):
    assert run(CALLER + FAILS.format("KeyboardInterrupt", 0.5)).stdout.endswith("interrupted\n")


def test_an_arm_without_effects_needs_none_of_their_machine_code(run):
    script = """
import numpy as np
import soft_tendon_env as ste
from soft_tendon_env.mechanics.terms.external_forces import external_force
for changes in ({"effects": {}}, {"effects.gravity.acceleration": [0.0, 0.0, -9.81]}):
    model = ste.build_model(ste.load_scene("three_tendon").replace(changes))
    ste.Simulation(model).step(np.zeros(3), 0.01)
    print(len(external_force.overloads))
"""
    assert run(script, XDG_CACHE_HOME=os.environ.get("XDG_CACHE_HOME")).stdout == "0\n1\n", "compiled or from the cache"
