"""Calls by symbols: no copies of a kernel in its callers, and the symbol is there wherever a caller's machine code is."""

import pytest
from numba import types

from soft_tendon_env.mechanics.algebra.linear import cholesky, copy
from soft_tendon_env.tools.compilation import kernel
from soft_tendon_env.tools.linking import can_be_called_by_symbol

CALLER, CALLEE = "linear.cholesky", "linear.row_stride"

SCRIPT = """
import numpy as np
from soft_tendon_env.mechanics.algebra.linear import cholesky, row_stride
a = np.zeros(2 * row_stride(2))
a[0], a[row_stride(2)], a[row_stride(2) + 1] = 4.0, 2.0, 5.0
print(cholesky(a, 2), a[0], a[row_stride(2)], a[row_stride(2) + 1])
"""
FACTOR = "True 0.5 1.0 0.5\n"  # [[2, 0], [1, 2]] with the inverse of its diagonal


@kernel
def _own(x):
    return x


def test_a_caller_holds_no_copy_of_the_kernel():
    signature = types.float64[::1], types.int64
    cholesky.compile(signature)
    code = cholesky.overloads[signature].library._get_module_for_linking()
    assert {function.is_declaration for function in code.functions if CALLEE in function.name} == {True}


@pytest.mark.no_jit
def test_only_kernels_that_every_process_finds_by_name_have_a_symbol():
    def inner(x):
        return x

    assert can_be_called_by_symbol(getattr(copy, "py_func", copy))
    assert not can_be_called_by_symbol(inner) and not can_be_called_by_symbol(getattr(_own, "py_func", _own))


def test_a_kernel_whose_file_is_missing_is_compiled_again_for_its_callers(run, tmp_path):
    assert run(SCRIPT).stdout == FACTOR
    codes = {path.name.split("-")[0]: path for path in (tmp_path / "cache").rglob("*.nbc")}
    times = {name: path.stat().st_mtime_ns for name, path in codes.items()}
    codes[CALLEE].unlink()
    assert run(SCRIPT.replace("row_stride(2)", "4")).stdout == FACTOR
    assert codes[CALLEE].is_file() and codes[CALLER].stat().st_mtime_ns == times[CALLER]
