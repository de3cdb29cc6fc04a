"""Versions of numba: internals are in one module, and on a version that was not tested kernels are compiled without them."""

import ast
import tomllib

import pytest

from soft_tendon_env.compiler.cache_folder import PACKAGE
from soft_tendon_env.compiler.numba_internals import TESTED
from soft_tendon_env.tools.versions import fits

PUBLIC = ("numba", "numba.core.errors", "numba.types", "numba.extending", "llvmlite", "llvmlite.binding", "llvmlite.ir")
PUBLIC_OF_CORE = {"cgutils", "config"}
INTERNALS = """
_cache _reduce _rebuild _reload_init _defns _nrt _ensure_finalized _get_module_for_linking add_linking_libs add_overload call_conv codegen
declare_function fndesc get_pointer_to_function has_dynamic_globals llvm_func_name llvm_cpython_wrapper_name magic_tuple mangled_name
remove_user_function targetoptions
""".split()
OF_CODE_GENERATORS = {"add_linking_libs", "call_conv"}
"""Attributes that code generators may ask of the context that `numba.extending` hands them."""

NEWER = "import numba\nnumba.__version__ = '0.999.0'\n"


@pytest.mark.no_jit
def test_internals_are_used_in_one_module():
    for source in PACKAGE.rglob("*.py"):
        if source.name == "numba_internals.py":
            continue
        for node in ast.walk(ast.parse(source.read_text())):
            if isinstance(node, ast.ImportFrom) and (node.module or "").partition(".")[0] in ("numba", "llvmlite"):
                names = {alias.name for alias in node.names}
                of_core = node.module == "numba.core" and names <= PUBLIC_OF_CORE
                assert node.module in PUBLIC or of_core, f"{source}: {node.module} {names}"
            if isinstance(node, ast.Attribute) and node.attr in set(INTERNALS) - OF_CODE_GENERATORS:
                raise AssertionError(f"{source}:{node.lineno} {node.attr}")


@pytest.mark.no_jit
def test_the_tested_versions_are_those_that_are_allowed():
    with (PACKAGE.parent / "pyproject.toml").open("rb") as file:
        assert f"numba{TESTED}" in tomllib.load(file)["project"]["dependencies"]


@pytest.mark.no_jit
@pytest.mark.cases(
    "version, expected",
    [("0.63.0", False), ("0.63.1", True), ("0.68.1", True), ("0.68.2rc1", True), ("0.69.0", False), ("0.69.0rc1", False), ("1.0", False)],
)
def test_which_versions_fit(version, expected):
    assert fits(version, TESTED) == expected


def test_on_a_version_that_was_not_tested_numba_compiles_and_says_so(run, tmp_path, two_kernels, problems):
    """The kernels of a user's script are not kept; those of the mechanics by numba."""
    own = "from soft_tendon_env.mechanics.algebra.linear import row_stride\nprint(row_stride(5), *row_stride.stats[1:])"
    script = NEWER + two_kernels + own
    results = []
    for _ in range(2):
        process = run(script)
        (line,) = problems(process.stderr)
        assert f"numba 0.999.0 is used without what was tested with numba {TESTED} alone" in line
        results.append(process.stdout)
    assert results == ["14.0 1\n8 Counter() Counter({(int64,): 1})\n", "14.0 1\n8 Counter({(int64,): 1}) Counter()\n"]
    assert [path.name.split("-")[0] for path in tmp_path.rglob("*.nbc")] == ["linear.row_stride"]
