"""Kernels: how they call one another, and what becomes of their machine code in later processes and
in children."""

import inspect
import os
import re
import shutil
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable
from typing import NamedTuple

import numba
import numpy as np
import pytest
from numba import config

from soft_tendon_env.compiler import compilation, first_use, kept_code
from soft_tendon_env.compiler.compilation import OPTIONS, Kernel, NotCompiledError, kernel
from soft_tendon_env.tools import files
from soft_tendon_env.tools.files import PACKAGE

jitted = pytest.mark.skipif(bool(config.DISABLE_JIT), reason="nothing is compiled")
PUBLIC = {
    "numba",
    "numba.extending",
    "numba.core.cgutils",
    "numba.core.compiler_lock.global_compiler_lock",
    "numba.core.event",
    "numba.core.typing.templates.AttributeTemplate",
}
"""What the package may import of numba: what its manual describes, and the lock that others which
compile with numba take too."""
INNER = (
    "from soft_tendon_env.compiler.compilation import kernel\n\n\n@kernel{}\ndef inner(x):\n   "
    " return {} * x\n"
)
OUTER = """
from soft_tendon_env.compiler.compilation import kernel
from soft_tendon_env.mechanics.inner import inner

@kernel
def outer(x):
    return inner(x) + inner(2.0 * x)
"""
MAIN = "from soft_tendon_env.mechanics.outer import outer\nprint(outer(1.0))"


LONGEST = 1800.0
"""Time [s] that no busy machine takes to load: what lasts longer hangs."""

FORKS = """
import os, sys, threading, time
import soft_tendon_env

def load():
    import soft_tendon_env.envs.tasks

thread = threading.Thread(target=load)
thread.start()
time.sleep(float(sys.argv[1]))
child = os.fork()
load()
if child == 0:
    os._exit(0)
longest = float(sys.argv[2])
deadline = time.monotonic() + longest
ended = 0
while not ended and time.monotonic() < deadline:
    ended, status = os.waitpid(child, os.WNOHANG)
    time.sleep(0.01)
if not ended:
    os.kill(child, 9)
    sys.exit("the child waits forever")
sys.exit(os.waitstatus_to_exitcode(status))
"""
"""A process that forks while another thread imports, after as many seconds."""


def fresh_kernel(function: Callable, **options) -> Callable:
    """A kernel such as those of the package."""
    return Kernel(function, {**OPTIONS, **options}).call


def scale(x, factor):
    return factor * x


class Pair(NamedTuple):
    a: float
    b: float


def add(pair):
    return pair.a + pair.b


def fail(out):
    out[0] = "text"


scale = fresh_kernel(scale)
add = fresh_kernel(add)
fail = Kernel(fail, OPTIONS, is_phase=True).call


@pytest.mark.no_jit
def test_only_public_names_of_numba_are_imported():
    for source in PACKAGE.rglob("*.py"):
        for module, names in re.findall(
            r"^\s*from (numba[\w.]*) import ([\w, ]+)", source.read_text(), re.MULTILINE
        ):
            assert (
                module in PUBLIC
                or {f"{module}.{name}" for name in names.strip().split(", ")} <= PUBLIC
            ), f"{source}: {module} {names}"


@jitted
def test_a_phase_is_compiled_when_it_is_first_called():
    def caller(calls, out):
        if calls:
            fail(out)
        out[0] += 1.0

    out = np.zeros(1)
    causes = (
        (fresh_kernel(caller), numba.TypingError, "str"),
        (kernel(caller), NotCompiledError, "fail cannot be compiled"),
    )
    for called, error, reason in causes:
        called(False, out)
        with pytest.raises(error, match=reason):
            called(True, out)
    assert out[0] == 2.0


@pytest.mark.slow
def test_a_second_process_compiles_nothing_until_a_kernel_in_another_file_changes(tmp_path):
    """Nor does one of another clone, whose files lie elsewhere."""
    clone = tmp_path / "clone"
    other = tmp_path / "other"
    mechanics = clone / "soft_tendon_env" / "mechanics"
    for name in ("compiler", "tools"):
        shutil.copytree(PACKAGE / name, mechanics.parent / name)
    mechanics.mkdir()
    for folder in (mechanics.parent, mechanics):
        (folder / "__init__.py").touch()
    (mechanics / "outer.py").write_text(OUTER)
    inherited = {
        name: value
        for name, value in os.environ.items()
        if not name.startswith(("NUMBA_", "SOFT_TENDON_ENV_"))
    }
    environment = {**inherited, "XDG_CACHE_HOME": str(tmp_path / "cache")}
    results = []
    for options in (("", 2.0), ("", 2.0), ("", 3.0), ("(inline=True)", 5.0)):
        inner = mechanics / "inner.py"
        text = INNER.format(*options)
        if not inner.exists() or inner.read_text() != text:  # numba looks at the time of writing
            inner.write_text(text)
        results.append(result_of_main(clone, environment))
    assert results == [(6.0, 1), (6.0, 0), (9.0, 1), (15.0, 1)]
    shutil.copytree(clone, other)
    assert result_of_main(other, environment) == (15.0, 0)


def result_of_main(folder, environment):
    """The number that the program in a folder prints, and how often it compiled."""
    process = subprocess.run(
        [sys.executable, "-c", MAIN],
        cwd=folder,
        env={**environment, "PYTHONPATH": str(folder)},
        capture_output=True,
        text=True,
        check=True,
    )
    return float(process.stdout), process.stderr.count("compiling for first use (cached in")


@jitted
def test_machine_code_for_a_users_own_class_is_not_kept(tmp_path, monkeypatch):
    """In the next process the class may not be there, and numba could read nothing of what it keeps
    of that kernel."""
    monkeypatch.setattr(compilation, "cache_folder", lambda: tmp_path)
    caller = kernel(lambda pair: add(pair))
    assert add(Pair(1.0, 2.0)) == caller(Pair(1.0, 2.0)) == 3.0
    assert not list(tmp_path.rglob("*.nb?"))
    assert fresh_kernel(inspect.unwrap(scale))(1.0, 2.0) == 2.0
    assert list(tmp_path.rglob("*.nb?"))


def test_the_first_folder_that_can_be_written_is_taken_with_what_is_in_a_read_only_one(
    tmp_path, monkeypatch, capsys
):
    blocked = tmp_path / "file"
    writable = tmp_path / "writable"
    blocked.touch()
    monkeypatch.setattr(files, "cache_parents", lambda: [blocked, writable])
    found = kept_code.cache_folder.__wrapped__()
    assert found.parent == writable / "soft_tendon_env"
    (found / "code.nbc").touch()
    (found / "kernel").mkdir(mode=0o500)
    monkeypatch.setattr(files, "cache_parents", lambda: [tmp_path / "new", writable])
    assert not (kept_code.cache_folder.__wrapped__() / "code.nbc").exists(), (
        "that folder can be written: it is for others"
    )
    monkeypatch.setattr(files, "cache_parents", lambda: [tmp_path / "newer", writable])
    monkeypatch.setattr(os, "access", lambda path, mode: False)
    copied = kept_code.cache_folder.__wrapped__()
    assert (copied / "code.nbc").exists()
    assert (copied / "kernel").stat().st_mode & 0o700 == 0o700, "numba writes into it"
    monkeypatch.setattr(files, "cache_parents", lambda: [blocked])
    assert kept_code.cache_folder.__wrapped__() is None
    assert (
        f"{blocked} cannot be used (Not a directory); set NUMBA_CACHE_DIR"
        in capsys.readouterr().err
    )


def test_only_the_newest_versions_are_kept(tmp_path, monkeypatch):
    monkeypatch.setattr(files, "cache_parents", lambda: [tmp_path])
    for i in range(5):
        folder = tmp_path / "soft_tendon_env" / f"{i:016x}"
        folder.mkdir(parents=True)
        os.utime(folder, (i, i))
    kept = {kept_code.cache_folder.__wrapped__().name, f"{3:016x}", f"{4:016x}"}
    assert {path.name for path in (tmp_path / "soft_tendon_env").iterdir()} == kept


def exit_code(child):
    """The exit status of a child, which is ended if it hangs."""
    deadline = time.monotonic() + LONGEST
    while time.monotonic() < deadline:
        ended, status = os.waitpid(child, os.WNOHANG)
        if ended:
            return os.waitstatus_to_exitcode(status)
        time.sleep(0.01)
    os.kill(child, signal.SIGKILL)
    os.waitpid(child, 0)
    pytest.fail("the child waits forever")


def exit_with(function, *arguments):
    """Ends a child with what a function returns, or with 99."""
    status = 99
    try:
        status = int(function(*arguments))
    finally:
        os._exit(status)


forking = pytest.mark.skipif(not hasattr(os, "fork"), reason="there are no forks")
ignoring_forks = pytest.mark.filterwarnings("ignore:.*multi-threaded, use of fork")


@jitted
@forking
@ignoring_forks
def test_a_process_is_forked_between_compilations(monkeypatch, tmp_path):
    """Its child would wait forever for a thread that it does not have."""
    begun = threading.Event()
    twice = fresh_kernel(inspect.unwrap(scale))
    monkeypatch.setattr(compilation, "cache_folder", lambda: tmp_path)
    monkeypatch.setattr(first_use, "say_once", lambda line: begun.set())
    thread = threading.Thread(target=twice, args=(1.0, 2.0))
    thread.start()
    assert begun.wait(LONGEST)
    child = os.fork()
    if child == 0:
        exit_with(twice, 1.0, 3.0)
    thread.join()
    assert exit_code(child) == 3


@jitted
@forking
@ignoring_forks
def test_a_thread_forks_within_its_own_compilation(monkeypatch, tmp_path):
    children = []
    other = fresh_kernel(inspect.unwrap(scale))

    def fork(line):
        if not children:
            children.append(os.fork())
            if children == [0]:
                exit_with(other, 1.0, 3.0)

    monkeypatch.setattr(compilation, "cache_folder", lambda: tmp_path)
    monkeypatch.setattr(first_use, "say_once", fork)
    assert fresh_kernel(inspect.unwrap(scale))(1.0, 2.0) == 2.0
    assert exit_code(children[0]) == 3


@pytest.mark.slow
@jitted
@forking
@pytest.mark.parametrize("seconds", [0.0, 0.1, 0.3, 1.0])
def test_a_process_is_forked_between_imports(seconds):
    """Its child would wait forever for a module that another thread imports."""
    process = subprocess.run(
        [sys.executable, "-W", "ignore", "-c", FORKS, str(seconds), str(LONGEST)],
        capture_output=True,
        text=True,
    )
    assert (process.returncode, process.stderr) == (0, "")
