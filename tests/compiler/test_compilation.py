"""The decorator and what is said on stderr.

What happens at first use happens once per process, so these tests start their own, with their own cache folder.
"""

import gc

import numba
import numpy as np
import pytest
from numba.core import event as events
from numba.core.errors import NumbaError

from soft_tendon_env.compiler.compilation import kernel


@pytest.mark.parametrize("enabled", [True, False])
def test_garbage_is_collected_again_after_a_compilation(enabled):
    """While numba compiles, it is not: its own garbage goes afterwards. Who has switched the collector off finds it off."""
    meanwhile = []

    class Listener(events.Listener):
        def on_start(self, event):
            meanwhile.append(gc.isenabled())

        def on_end(self, event):
            pass

    before = gc.isenabled()
    (gc.enable if enabled else gc.disable)()
    try:
        with events.install_listener("numba:compile", Listener()):
            assert kernel(lambda x: x + 1)(1) == 2
            with pytest.raises(NumbaError):
                kernel(lambda x: x.nothing)(1)
        assert gc.isenabled() == enabled
    finally:
        (gc.enable if before else gc.disable)()
    assert meanwhile and not any(meanwhile)  # what fails is never kept, and so compiled every time


def test_silenced_by_the_environment(run, two_kernels):
    assert run(two_kernels, SOFT_TENDON_ENV_QUIET="1").stderr == ""


def test_without_jit_a_kernel_is_the_plain_function(run, tmp_path, two_kernels):
    plain = two_kernels.replace("sum(sum_of_squares.stats.cache_misses.values())", "type(sum_of_squares).__name__")
    process = run(plain, NUMBA_DISABLE_JIT="1")
    assert (process.stdout, process.stderr) == ("14.0 function\n", "")
    assert not (tmp_path / "cache").exists()


def test_caches_of_other_packages_stay_where_they_were():
    before = numba.config.CACHE_DIR
    kernel(lambda x: x)
    assert numba.config.CACHE_DIR == before
    with pytest.raises(TypeError):
        kernel("not a function")
    assert numba.config.CACHE_DIR == before


def test_a_child_forked_while_another_thread_compiles_can_compile(run):
    """Nobody in the child ends what a thread has begun; so the fork waits."""
    script = """
import os, signal, threading, time
from numba.core import event
from soft_tendon_env.compiler.compilation import kernel

class Slow(event.Listener):
    def on_start(self, _):
        compiling.set()
        time.sleep(1.0)
    def on_end(self, _):
        pass

event.register("numba:compile", Slow())
compiling = threading.Event()

@kernel
def double(x):
    return 2.0 * x

@kernel
def triple(x):
    return 3.0 * x

thread = threading.Thread(target=double, args=(1.0,))
thread.start()
compiling.wait()
child = os.fork()
if child == 0:
    signal.alarm(20)
    os._exit(0 if triple(double(1.0)) == 6.0 else 1)
print(os.waitpid(child, 0)[1], triple(double(1.0)))
"""
    assert run(script).stdout == "0 6.0\n"


def test_kernels_from_elsewhere_may_make_arrays_and_return_parts_of_them():
    @kernel
    def last_of_doubled(x):
        doubled = np.zeros(x.size)
        for i in range(x.size):
            doubled[i] = 2.0 * x[i]
        return doubled[1:]

    np.testing.assert_array_equal(last_of_doubled(np.array([1.0, 2.0, 3.0])), [4.0, 6.0])


@pytest.mark.skipif(numba.config.DISABLE_JIT, reason="nothing is compiled")
def test_kernels_that_are_not_counted_are_refused_arrays_of_their_own():
    @kernel(counted=False)
    def zeros(n):
        return np.zeros(n)

    with pytest.raises(NumbaError, match="Only accept returning of array passed"):
        zeros(3)
