"""Calls by symbols: no copies of a kernel in its callers, and the symbol is there wherever a caller's machine code is."""

import pytest
from numba import types

from soft_tendon_env.compiler.cache_folder import PACKAGE
from soft_tendon_env.compiler.code_digest import selected_code
from soft_tendon_env.compiler.compilation import kernel
from soft_tendon_env.compiler.linking import Definition, is_of_package, kernel_digest
from soft_tendon_env.effects.gravity import GravityParameters
from soft_tendon_env.mechanics.algebra.linear import copy, row_stride, solve_positive_definite

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


@kernel
def _own(x):
    return x


def test_a_caller_needs_the_symbol_and_links_no_code():
    signature = types.float64[::1], types.int64, types.float64[::1]
    solve_positive_definite.compile(signature)
    compiled = solve_positive_definite.overloads[signature]
    symbol = row_stride._cache.symbol((types.int64,), row_stride.targetctx)
    defined = [own for own in compiled.library._reload_init if isinstance(own, Definition)]
    assert (LINEAR, "row_stride", (types.int64,), symbol) in [own[:4] for own in defined]
    assert all(function.is_declaration for function in compiled.library._get_module_for_linking().functions if CALLEE in function.name)


def test_a_symbol_that_the_kernel_has_no_more_is_an_error_and_no_jump_to_nowhere():
    definition = Definition(LINEAR, "row_stride", (types.int64,), "soft_tendon_env/elsewhere.nbc", kernel_digest(LINEAR, "row_stride"))
    with pytest.raises(LookupError, match=r"calls soft_tendon_env/elsewhere\.nbc, which is not there"):
        definition()
    with pytest.raises(LookupError, match="calls another version of row_stride in"):
        definition._replace(made_for="0123456789abcdef")()
    for module, name in ((LINEAR, "rows"), ("soft_tendon_env.nowhere", "row_stride")):
        with pytest.raises(LookupError, match=f"calls {name} in {module}, which is not there"):
            Definition(module, name, (), "")()


@pytest.mark.no_jit
def test_symbols_do_not_tell_where_the_package_lies():
    """Copies of the package share machine code, in which the symbols of other kernels stand."""
    gravity = types.NamedTuple([types.float64], GravityParameters)
    places, _ = selected_code([gravity])
    assert places and all("effects/gravity.py" in place and str(PACKAGE) not in place for place in places)


@pytest.mark.no_jit
def test_only_kernels_that_every_process_finds_by_name_have_a_symbol():
    def inner(x):
        return x

    assert is_of_package(getattr(copy, "py_func", copy))
    assert not is_of_package(inner) and not is_of_package(getattr(_own, "py_func", _own))


def test_a_kernel_whose_file_is_missing_is_compiled_again_for_its_callers(run, tmp_path):
    assert run(SCRIPT).stdout == SOLUTION
    cache = tmp_path / "cache"
    written = {path: path.stat().st_mtime_ns for path in cache.rglob(f"{CALLER}-*.nbc")}
    for path in cache.rglob(f"{CALLEE}-*.nbc"):
        path.unlink()
    assert run(SCRIPT.replace("row_stride(3)", "4")).stdout == SOLUTION
    assert [*cache.rglob(f"{CALLEE}-*.nbc")] and written == {path: path.stat().st_mtime_ns for path in written}


def test_python_can_call_what_kernels_have_called_before(run):
    called = "solve_positive_definite(np.ones(4), 1, np.ones(1))"
    before = f"import gc\nimport numpy as np\nfrom soft_tendon_env.mechanics.algebra.linear import solve_positive_definite\n{called}\n"
    assert run(before + SCRIPT + f"gc.collect()\nprint({called}, row_stride(5))").stdout == f"{SOLUTION}True 8\n"


INLINED = """
from soft_tendon_env.mechanics.terms.kinematics import interval_operators
from soft_tendon_env.compiler.compilation import kernel

@kernel
def {name}(x):
    still, turned = ((0.0, 0.0, x), (1.0, 0.0, 0.0)), (1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0)
    return interval_operators(0.1, 0.05, 0.001, still, still, turned, (0.0, 0.0, 0.0))[4][0][2]

print({name}(2.0), sum({name}.stats.cache_misses.values()))
"""


@pytest.mark.slow
def test_a_caller_of_what_was_inlined_from_the_cache_brings_its_symbols(run, problems):
    """`interval_operators` calls by a symbol: the second caller finds its code in the cache, the third process that caller."""
    assert run(INLINED.format(name="first")).stdout == "0.2 1\n"
    assert run(INLINED.format(name="second")).stdout == "0.2 1\n"
    again = run(INLINED.format(name="second"))
    assert again.stdout == "0.2 0\n" and not problems(again.stderr)
