"""The decorator and what is said on stderr.

What happens at first use happens once per process, so these tests start their own, with their own cache folder.
"""

import gc

import pytest
from numba.core import event as events
from numba.core.errors import NumbaError

from soft_tendon_env.compiler.compilation import kernel


@pytest.mark.cases("enabled", [True, False])
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
