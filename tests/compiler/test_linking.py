"""Calls by symbols: the symbol is there wherever a caller's machine code is."""

import pytest
from numba import types

from soft_tendon_env.compiler.linking import Definition, kernel_digest

LINEAR = "soft_tendon_env.mechanics.algebra.linear"
CALLER, CALLEE = "linear.solve_positive_definite", "linear.row_stride"

SCRIPT = """
import numpy as np
from soft_tendon_env.mechanics.algebra.linear import row_stride, solve_positive_definite
a, x = np.zeros(2 * row_stride(3)), np.zeros(2)
a[:3], a[row_stride(3) + 1 : row_stride(3) + 3] = [4.0, 2.0, 8.0], [5.0, 12.0]
print(solve_positive_definite(a, 2, x), x)
"""
SOLUTION = "True [1. 2.]\n"


def test_a_symbol_that_the_kernel_has_no_more_is_an_error_and_no_jump_to_nowhere():
    definition = Definition(LINEAR, "row_stride", (types.int64,), "soft_tendon_env/elsewhere.nbc", kernel_digest(LINEAR, "row_stride"))
    with pytest.raises(LookupError, match=r"calls soft_tendon_env/elsewhere\.nbc, which is not there"):
        definition()
    with pytest.raises(LookupError, match="calls another version of row_stride in"):
        definition._replace(made_for="0123456789abcdef")()
    for module, name in ((LINEAR, "rows"), ("soft_tendon_env.nowhere", "row_stride")):
        with pytest.raises(LookupError, match=f"calls {name} in {module}, which is not there"):
            Definition(module, name, (), "")()


def test_a_kernel_whose_file_is_missing_is_compiled_again_for_its_callers(run, tmp_path):
    assert run(SCRIPT).stdout == SOLUTION
    cache = tmp_path / "cache"
    written = {path: path.stat().st_mtime_ns for path in cache.rglob(f"{CALLER}-*.nbc")}
    for path in cache.rglob(f"{CALLEE}-*.nbc"):
        path.unlink()
    assert run(SCRIPT.replace("row_stride(3)", "4")).stdout == SOLUTION
    assert [*cache.rglob(f"{CALLEE}-*.nbc")] and written == {path: path.stat().st_mtime_ns for path in written}
