"""Versions of numba: internals are in one module, and on a version that was not tested kernels are compiled without them."""

import ast
import tomllib

import numpy as np
import pytest

from soft_tendon_env.compiler.cache_folder import PACKAGE
from soft_tendon_env.compiler.numba_internals import PLAIN, TESTED
from soft_tendon_env.tools.versions import fits, release

PUBLIC = ("numba", "numba.core.errors", "numba.types", "numba.extending", "llvmlite", "llvmlite.binding", "llvmlite.ir")
PUBLIC_OF_CORE = {"cgutils", "config"}
INTERNALS = """
_cache _reduce _rebuild _reload_init _defns _nrt _ensure_finalized _get_module_for_linking add_linking_libs add_overload call_conv codegen
declare_function fndesc get_pointer_to_function has_dynamic_globals llvm_func_name llvm_cpython_wrapper_name magic_tuple mangled_name
remove_user_function targetoptions
""".split()
OF_CODE_GENERATORS = {"add_linking_libs", "call_conv"}
"""Attributes that code generators may ask of the context that `numba.extending` hands them."""

EPISODE = """
import sys
import gymnasium as gym
import numpy as np
from soft_tendon_env.registration import IDS
env = gym.make(IDS["Reach"])
(observation, _), actions, over, history = env.reset(seed=0), np.random.default_rng(0), False, []
while not over:
    observation, reward, terminated, truncated, _ = env.step(actions.uniform(-1.0, 1.0, env.action_space.shape))
    history.append(np.concatenate([*map(np.ravel, observation.values()), [reward]]))
    over = terminated or truncated
np.save(sys.argv[0] + ".npy", history)
"""
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


@pytest.mark.no_jit
def test_numbers_of_versions():
    assert release("2.13.0+cpu") == (2, 13) and release("1.0") == (1,) and release("2.60.1.post1") == (2, 60, 1)
    assert fits("2.0", "==2") and fits("3", ">=3") and not fits("3", "<3") and fits("1", "")


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


GONE = """
import builtins
found = builtins.__import__
def gone(name, namespace=None, *rest):
    own = (namespace or {}).get("__name__") == "soft_tendon_env.compiler.numba_internals"
    if own and name.startswith("numba.core.") and name != "numba.core.typing.templates":
        raise ImportError(f"{name} is gone")
    return found(name, namespace, *rest)
builtins.__import__ = gone
"""


def test_modules_of_internals_may_go(run, two_kernels):
    """As in a release to come: nothing of what tested versions alone need is imported."""
    assert run(NEWER + GONE + two_kernels).stdout == "14.0 1\n"


@pytest.mark.slow
@pytest.mark.timeout(600)
def test_an_episode_without_internals_is_the_same_up_to_round_off(start):
    """Compiled by numba alone, where other functions are inlined and fused; and from numba's cache in a second process, bit for bit."""
    episodes = []
    for variables in ({}, {PLAIN: "1"}, {PLAIN: "1"}):
        process = start(EPISODE, **variables)
        _, stderr = process.communicate(timeout=500)
        assert process.returncode == 0, stderr
        episodes.append(np.load(f"{process.args[1]}.npy"))
    single = np.finfo(np.float32).eps  # of observations
    assert len(episodes[0]) == 500
    np.testing.assert_allclose(episodes[1], episodes[0], rtol=2.0 * single, atol=1e-10)
    np.testing.assert_array_equal(episodes[2], episodes[1])
