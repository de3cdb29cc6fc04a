"""Machine code that lies in files: of a user's own compiled functions that call kernels, after an upgrade; and forged by somebody else.

A function that is cached by `numba.njit(cache=True)` knows its own source file alone, and calls kernels of the package by symbols or holds
copies of them. Whoever can write a file that is loaded as machine code, or unpickled with it, runs what he likes.
"""

import hashlib
import os
import pickle
import shutil

import pytest

from soft_tendon_env.compiler.cache_folder import PACKAGE, UnsafeError, open_folder
from soft_tendon_env.compiler.kernel_folder import KernelFolder

OWN = """
import numba
from soft_tendon_env.effects.own import twice
from soft_tendon_env.mechanics.algebra.lie import dot
from soft_tendon_env.mechanics.algebra.linear import row_stride

@numba.njit(cache=True)
def called(n):
    return row_stride(n)

@numba.njit(cache=True)
def inlined(x):
    return dot((x, 1.0, 1.0), (1.0, 1.0, 1.0))

@numba.njit(cache=True)
def of_effect(x):
    return twice(x)
"""
CALLER = """
import numba
from own import called

@numba.njit(cache=True)
def caller(n):
    return called(n) + 1
"""
EFFECT = "from soft_tendon_env.compiler.compilation import kernel\n\n\n@kernel\ndef twice(x):\n    return 2.0 * x\n"
USE_ALL = """
from own import called, inlined, of_effect
functions = called, inlined, of_effect
print(called(5), inlined(1.0), of_effect(1.0), sum(sum(own.stats.cache_misses.values()) for own in functions))
"""
USE_CALLER = "from second import caller\nprint(caller(5), sum(caller.stats.cache_misses.values()))"


@pytest.fixture
def package(tmp_path):
    """A folder with a copy of the package, that of a user's functions beside it, and an effect's kernel in it."""
    shutil.copytree(PACKAGE, tmp_path / "soft_tendon_env", ignore=shutil.ignore_patterns("__pycache__", "trained", "configs"))
    (tmp_path / "soft_tendon_env" / "effects" / "own.py").write_text(EFFECT)
    (tmp_path / "own.py").write_text(OWN)
    (tmp_path / "second.py").write_text(CALLER)
    return tmp_path


def changed(path, old, new):
    text = path.read_text()
    assert old in text
    path.write_text(text.replace(old, new))


@pytest.mark.slow
def test_own_cached_functions_after_an_upgrade(run, package, measured):
    """A user's functions with `numba.njit(cache=True)` call a kernel by its symbol, inline another and call an effect's; of the package a
    body, then the lines, then the effect's body change.
    Expected: each is compiled again, none ends the process, and the numbers are those of the new code.
    """
    mechanics, stale, missed = package / "soft_tendon_env" / "mechanics" / "algebra", 0, []

    def use(expected):
        nonlocal stale
        *values, misses = map(float, run(USE_ALL, PYTHONPATH=str(package)).stdout.split())
        stale += sum(value != wanted for value, wanted in zip(values, expected, strict=True))
        missed.append(misses)

    use([8, 3.0, 2.0])
    use([8, 3.0, 2.0])
    changed(mechanics / "linear.py", "return (n + LANES - 1) // LANES * LANES", "return (n + LANES - 1) // LANES * LANES + 100")
    use([108, 3.0, 2.0])
    changed(mechanics / "linear.py", "import math\n", "import math\n\n# moved\n")
    changed(mechanics / "lie.py", "return x[0] * y[0] + x[1] * y[1]", "return 10.0 + x[0] * y[0] + x[1] * y[1]")
    use([108, 13.0, 2.0])
    changed(package / "soft_tendon_env" / "effects" / "own.py", "2.0 * x", "3.0 * x")
    use([108, 13.0, 3.0])
    use([108, 13.0, 3.0])
    measured("results of the code of before", stale)
    assert not stale and missed == [3, 0, 3, 3, 1, 0]


@pytest.mark.slow
def test_a_caller_of_what_came_from_numbas_cache(run, start, package):
    """A user's cached function calls one that was loaded from numba's cache, which forgets what symbols that one needs: the machine code of
    the caller then has a symbol that no definition defines, and the process that loads it jumps to nowhere.
    Expected: its machine code comes with the definition of the symbol; what was cached without it by an older version is compiled again.
    """
    first = "from own import called\nprint(called(5), sum(called.stats.cache_misses.values()))"
    for script, expected in ((first, "8 1\n"), (USE_CALLER, "9 1\n"), (USE_CALLER, "9 0\n")):
        assert run(script, PYTHONPATH=str(package)).stdout == expected
    forgetful = "from soft_tendon_env.compiler import numba_internals\nnumba_internals.CompileResult._rebuild = numba_internals._REBUILD\n"
    shutil.rmtree(package / "__pycache__")
    for script in (first, USE_CALLER):
        run(forgetful + script, PYTHONPATH=str(package))
    process = start(forgetful + USE_CALLER, PYTHONPATH=str(package))  # numba as it is
    process.communicate(timeout=60)
    assert process.returncode < 0
    assert run(USE_CALLER, PYTHONPATH=str(package)).stdout == "9 1\n"


def given_away(path):
    """To another user, which only root can do."""
    os.chown(path, 4242, -1, follow_symlinks=False)


def moved_behind_a_link(path):
    path.rename(path.with_name("behind"))
    path.symlink_to(path.with_name("behind"))
    (path.with_name("behind")).chmod(0o777)


LEVELS = {"root": 0, "version": 1, "module": 2, "file": 3}
WAYS = {
    "others can write": lambda path: path.chmod(0o777),
    "a group can write": lambda path: path.chmod(0o770),
    "anybody may add to it": lambda path: path.chmod(0o1777),
    "another user's": given_away,
    "behind a link": moved_behind_a_link,
}


def test_forged_machine_code(two_kernels, run, tmp_path, malice, measured, capsys):
    """Files with a right digest whose pickle runs a command, in a cache whose folders or files others can write, or own, at every level.
    Expected: none is unpickled, one line says why and the kernels are compiled; the same file in a safe folder is this user's own.
    """
    cache, marker, ran = tmp_path / "cache", tmp_path / "ran", 0
    assert run(two_kernels, XDG_CACHE_HOME=str(cache)).stdout == "14.0 1\n"
    (file,) = cache.rglob("script.sum_of_squares-*.nbc")
    levels = [cache / "soft_tendon_env", *reversed(file.parents[:2]), file]
    content = file.read_bytes()[32:64] + pickle.dumps(malice(marker))
    file.write_bytes(hashlib.sha256(content).digest() + content)
    shutil.copytree(cache, tmp_path / "kept", symlinks=True)
    for level, way in ((level, way) for level in LEVELS for way in WAYS if way != "another user's" or os.getuid() == 0):
        shutil.rmtree(cache)
        shutil.copytree(tmp_path / "kept", cache)
        WAYS[way](levels[LEVELS[level]])
        try:
            folder = open_folder(levels[0], levels[1].name)
            assert KernelFolder(folder).read(str(file.relative_to(folder))) is None
            assert capsys.readouterr().err.count("\n") == 1
        except UnsafeError as error:
            assert level in ("root", "version") and ("others can write" in error.strerror or "another user" in error.strerror)
        if (level, way) in (("root", "others can write"), ("module", "another user's"), ("file", "others can write")):
            process = run(two_kernels, XDG_CACHE_HOME=str(cache), TMPDIR=str(tmp_path))
            assert process.stdout == "14.0 1\n" and process.stderr.count("others can write") + process.stderr.count("another user") == 1
            ran += marker.exists()
    measured("commands that ran", ran)
    assert not ran
    shutil.rmtree(cache)
    shutil.copytree(tmp_path / "kept", cache)
    run(two_kernels, XDG_CACHE_HOME=str(cache))
    assert marker.exists()
