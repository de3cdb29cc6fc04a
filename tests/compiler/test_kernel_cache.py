"""The files of machine code: where they lie, what becomes of broken and of unwritable ones, and who compiles.

What becomes of full disks, killed processes and dropped folders is in tests/hard_cases too.
numba is started in processes of their own, with small kernels.
"""

import contextlib
import errno
import os
import re
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
from filelock import FileLock, Timeout
from numba.core.errors import NumbaWarning, TypingError

from soft_tendon_env.compiler import kernel_cache, kernel_folder
from soft_tendon_env.compiler.cache_folder import PACKAGE
from soft_tendon_env.compiler.compilation import kernel
from soft_tendon_env.compiler.kernel_folder import KernelFolder

COMPILED, LOADED = "14.0 1\n", "14.0 0\n"


def machine_code(folder: Path) -> list[Path]:
    return sorted(folder.rglob("*.nbc"))


def names(folder: Path) -> list[str]:
    """The functions whose machine code lies below the folder."""
    return [path.name.split("-")[0] for path in machine_code(folder)]


def leftovers(folder: Path) -> list[Path]:
    """Files below the folder that are no machine code."""
    return [path for path in folder.rglob("*") if path.is_file() and path.suffix != ".nbc" and path.name != kernel_folder.LOCK]


def finish(*processes: subprocess.Popen[str], seconds: float = 60.0) -> tuple[list[str], list[str]]:
    """Their texts on stdout and on stderr."""
    texts = [process.communicate(timeout=seconds) for process in processes]
    assert [process.returncode for process in processes] == [0] * len(processes), texts
    return [text[0] for text in texts], [text[1] for text in texts]


def remount(folder, options):
    subprocess.run(["mount", "-o", f"remount,{options}", str(folder)], check=True)


def wait_until(condition, seconds: float = 30.0) -> None:
    end = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < end
        time.sleep(0.01)


EVERY_LINE = "from soft_tendon_env.compiler import compilation_progress as lines; lines.NOTICEABLE = 0.0\n"


def test_the_first_process_compiles_and_says_so_and_the_second_loads_in_silence(run, tmp_path, two_kernels):
    """Nested functions are counted once."""
    first, second = run(EVERY_LINE + two_kernels), run(EVERY_LINE + two_kernels)
    assert (first.stdout, second.stdout, second.stderr) == (COMPILED, LOADED, "")
    assert first.stderr.count("compiling for first use") == 1 and "compiled 2 functions, " in first.stderr
    assert str(tmp_path / "cache" / "soft_tendon_env") in first.stderr
    assert names(tmp_path / "cache" / "soft_tendon_env") == ["script.square", "script.sum_of_squares"]
    assert not leftovers(tmp_path)[1:], "something beside the script and its machine code"


def test_a_full_folder_that_can_only_be_read_is_read(run, small_disk, two_kernels, problems):
    """As in the image of a container, where kernels have been compiled beforehand."""
    remount(small_disk, "size=4m")
    run(two_kernels, NUMBA_CACHE_DIR=str(small_disk))
    remount(small_disk, "ro")
    process = run(two_kernels, NUMBA_CACHE_DIR=str(small_disk))
    assert (process.stdout, process.stderr) == (LOADED, "")
    process = run(two_kernels + "print(kernel(lambda x: x)(1))", NUMBA_CACHE_DIR=str(small_disk))
    assert process.stdout.endswith("\n1\n")  # the script has changed, so that all is compiled
    (line,) = problems(process.stderr)
    assert "Read-only file system" in line


def test_the_package_is_compiled_once_wherever_it_lies(run, tmp_path):
    shutil.copytree(PACKAGE, tmp_path / "elsewhere" / "soft_tendon_env", ignore=shutil.ignore_patterns("__pycache__"))
    script = """
from soft_tendon_env.mechanics.algebra.lie import dot
print(dot((1.0, 2.0, 3.0), (1.0, 1.0, 1.0)), sum(dot.stats.cache_misses.values()))
"""
    assert [run(script, PYTHONPATH=str(folder)).stdout for folder in (PACKAGE.parent, tmp_path / "elsewhere")] == ["6.0 1\n", "6.0 0\n"]


# What cannot be written


NO_SPACE = """
import resource, signal
signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
resource.setrlimit(resource.RLIMIT_FSIZE, (BYTES, BYTES))
"""


def test_a_full_disk_is_said_once(run, small_disk, two_kernels, problems):
    """Nothing is left on the disk that would be taken for machine code, and with room again it is used."""
    (small_disk / "full").write_bytes(bytes(64 * 1024))
    process = run(two_kernels, NUMBA_CACHE_DIR=str(small_disk))
    assert process.stdout == COMPILED
    (line,) = problems(process.stderr)
    assert "No space left on device" in line and str(small_disk) in line
    assert not leftovers(small_disk / "soft_tendon_env")
    (small_disk / "full").unlink()
    remount(small_disk, "size=4m")
    assert run(two_kernels, NUMBA_CACHE_DIR=str(small_disk)).stdout == COMPILED
    assert run(two_kernels, NUMBA_CACHE_DIR=str(small_disk)).stdout == LOADED


@pytest.mark.parametrize("turned", ["ro", "umounted"])
def test_a_disk_that_goes_away_is_said_once(run, small_disk, turned, two_kernels, problems):
    remount(small_disk, "size=4m")
    command = {"ro": ["mount", "-o", "remount,ro"], "umounted": ["umount", "-l"]}[turned] + [str(small_disk)]
    again = "" if turned == "ro" else f"\nsubprocess.run(['mount', '-t', 'tmpfs', '-o', 'ro', 'tmpfs', {str(small_disk)!r}], check=True)"
    script = f"import subprocess, soft_tendon_env.compiler.compilation\nsubprocess.run({command}, check=True){again}\n" + two_kernels
    process = run(script, NUMBA_CACHE_DIR=str(small_disk))
    assert process.stdout == COMPILED
    (line,) = problems(process.stderr)
    assert "Read-only file system" in line


def test_a_stderr_that_cannot_be_written_stops_nothing(run, two_kernels):
    with open("/dev/full", "w") as full:  # unbuffered: Python itself ends with status 120 where it cannot flush what it buffered
        assert run(NO_SPACE.replace("BYTES", "0") + two_kernels, stderr=full, PYTHONUNBUFFERED="1").stdout == COMPILED
    assert run("import sys; sys.stderr = None\n" + two_kernels).stdout == COMPILED


@pytest.mark.cases("number", [errno.ENOSPC, errno.EDQUOT, errno.EROFS, errno.EACCES, errno.EIO, errno.ESTALE])
@pytest.mark.cases("call", ["os.replace", "pathlib.Path.write_bytes", "pathlib.Path.mkdir"])
def test_no_call_that_fails_gets_through(tmp_path, capsys, call, number):
    path = tmp_path / f"{call}-{number}"
    folder = KernelFolder(path)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(call, lambda *_, **__: (_ for _ in ()).throw(OSError(number, os.strerror(number))))
        for name in ("one.nbc", "two.nbc"):
            with folder.compiling():
                folder.lock()
                folder.write(name, b"code")
    assert capsys.readouterr().err.count("\n") == 1
    assert not machine_code(path) and not leftovers(path)
    folder.write("one.nbc", b"code")
    assert folder.read("one.nbc") == b"code"


def test_nobody_waits_for_what_cannot_be_kept(tmp_path, monkeypatch, capsys):
    folder, other = KernelFolder(tmp_path), FileLock(tmp_path / kernel_folder.LOCK)
    full = OSError(errno.ENOSPC, "full")

    def is_free():
        with contextlib.suppress(Timeout), other.acquire(blocking=False):
            return True
        return False

    with folder.compiling():
        folder.lock()
        assert not is_free()
        with monkeypatch.context() as patch:
            patch.setattr(os, "replace", lambda *_: (_ for _ in ()).throw(full))
            folder.write("callee.nbc", b"code")
        assert is_free()
        folder.lock()
        assert is_free()
        folder.write("callee.nbc", b"code")  # there is room again
        with folder.compiling():
            folder.lock()
        assert not is_free(), "before the end of the outermost compilation"
    assert is_free()


# What is broken


def cut(part):
    return lambda content: content[: int(part * len(content))]


DAMAGE = {
    "empty": cut(0.0), "cut in the digest": cut(0.0001), "cut in half": cut(0.5), "last byte missing": lambda content: content[:-1],
    "zeros at the end": lambda content: content[:-1000] + bytes(1000), "zeros": lambda content: bytes(len(content)),
    "a bit": lambda content: content[:5000] + bytes([content[5000] ^ 1]) + content[5001:], "too long": lambda content: content + b"x",
    "text": lambda content: b"no machine code", "numba's": lambda content: content[32:],
}  # fmt: skip


@pytest.mark.cases("damage", [*DAMAGE])
def test_files_that_were_cut_or_damaged_are_deleted_and_named_once(tmp_path, capsys, damage, problems):
    folder, names = KernelFolder(tmp_path / damage), ("one.nbc", "two.nbc")
    for name in names:
        folder.write(name, bytes(range(256)) * 40)
        assert folder.read(name) == bytes(range(256)) * 40
        file = tmp_path / damage / name
        file.write_bytes(DAMAGE[damage](file.read_bytes()))
        assert folder.read(name) is None and not file.exists()
    (line,) = problems(capsys.readouterr().err)
    assert "broken machine code" in line and names[0] in line and "compiled again" in line


def test_broken_machine_code_is_compiled_again(run, tmp_path, two_kernels, problems):
    run(two_kernels)
    files = machine_code(tmp_path / "cache")
    for file in files:
        file.write_bytes(DAMAGE["a bit"](file.read_bytes()))
    process = run(two_kernels)
    assert process.stdout == COMPILED
    (line,) = problems(process.stderr)
    assert "broken machine code" in line and any(str(file) in line for file in files) and "compiled again" in line
    process = run(two_kernels)
    assert (process.stdout, process.stderr) == (LOADED, "")


def test_a_broken_file_that_cannot_be_deleted_is_passed_over(tmp_path, monkeypatch, capsys):
    folder, file = KernelFolder(tmp_path), tmp_path / "a.nbc"
    file.write_bytes(b"broken")
    monkeypatch.setattr(Path, "unlink", lambda *_, **__: (_ for _ in ()).throw(PermissionError(errno.EACCES, "no")))
    assert folder.read(file) is None and folder.read(file) is None
    assert capsys.readouterr().err.count("\n") == 1


def test_machine_code_that_cannot_be_rebuilt_is_compiled_again(run, tmp_path, two_kernels, problems):
    """Whole, but it names a class that is not there any more."""
    run(two_kernels)
    write = """
from soft_tendon_env.compiler.kernel_folder import KernelFolder
from pathlib import Path
import sys
for file in Path(sys.argv[0]).parent.rglob("*.nbc"):
    folder = KernelFolder(file.parent)
    folder.write(file, folder.read(file)[:32] + b"csome_module\\nSomeClass\\n.")
"""
    subprocess.run([sys.executable, "-c", write.replace("sys.argv[0]", repr(str(tmp_path / "x")))], check=True)
    process = run(two_kernels)
    assert process.stdout == COMPILED and len(problems(process.stderr)) == 1 and "ModuleNotFoundError" in process.stderr
    assert run(two_kernels).stdout == LOADED


def test_something_else_in_the_place_of_a_file_is_said(run, tmp_path, two_kernels, problems):
    run(two_kernels)
    for file in machine_code(tmp_path / "cache"):
        file.unlink()
        file.mkdir()
        (file / "content").touch()
    process = run(two_kernels)
    assert process.stdout == COMPILED and len(problems(process.stderr)) == 1 and "Is a directory" in process.stderr


# Which machine code is right


def test_a_changed_source_is_compiled_again_in_the_same_file(run, tmp_path, two_kernels):
    run(two_kernels)
    before = machine_code(tmp_path / "cache")
    assert run(two_kernels.replace("x * x", "x * 2")).stdout == "12.0 1\n"
    assert machine_code(tmp_path / "cache") == before


def test_kernels_that_are_alike_are_told_apart(run, tmp_path):
    """Signatures, closures, and lambdas of one line, by their constants alone, which numba's own cache does not look at. Those
    of one line have one file, and so has a kernel that holds another, which numba names by chance."""
    script = """
from soft_tendon_env.compiler.compilation import kernel
def times(factor):
    return kernel(lambda x: factor * x)
def twice(f):
    return kernel(lambda x: f(f(x)))
print([times(factor)(x) for factor in (2, 3) for x in (1, 1.5)])
print([f(1) for f in (kernel(lambda x: 2 * x), kernel(lambda x: 3 * x))])
print(twice(kernel(lambda x: 3 * x))(1))
"""
    assert [run(script).stdout for _ in range(3)] == ["[2, 3.0, 3, 4.5]\n[2, 3]\n9\n"] * 3
    assert len(machine_code(tmp_path / "cache")) == 4 + 1 + 2


def test_recompiling_does_not_load(run, tmp_path, two_kernels):
    script = two_kernels + "sum_of_squares.recompile(); print(sum(sum_of_squares.stats.cache_misses.values()))"
    run(script)
    assert run(script).stdout == "14.0 0\n1\n"


def test_functions_without_a_source_are_compiled_and_not_kept(run, tmp_path):
    script = "from soft_tendon_env.compiler.compilation import kernel\nscope = {'kernel': kernel}\n"
    process = run(script + "exec('@kernel\\ndef double(x):\\n    return 2 * x', scope)\nprint(scope['double'](2.0))")
    assert process.stdout == "4.0\n" and not machine_code(tmp_path)


def test_machine_code_with_addresses_is_not_kept():
    table = np.zeros(1_000_000)

    @kernel
    def first():
        return table[0]

    with pytest.warns(NumbaWarning, match="first holds addresses or large arrays"):
        assert first() == 0.0
    assert not list(Path(first.stats.cache_path).glob("*.locals.first-*"))


# Who compiles


def test_of_two_processes_one_compiles_and_the_other_waits_and_says_so(start, tmp_path, two_kernels, slowly):
    script = slowly(two_kernels, 1.0, together=2, SECONDS_BEFORE_LINE=0.1)
    stdout, stderr = finish(*(start(script) for _ in range(2)))
    assert sorted(stdout) == [LOADED, COMPILED]
    waiting, compiling = stdout.index(LOADED), stdout.index(COMPILED)
    assert stderr[waiting] == "soft_tendon_env: waiting for another process, which compiles\n" and "waiting" not in stderr[compiling]
    assert not leftovers(tmp_path / "cache")
    for path in machine_code(tmp_path / "cache"):
        path.unlink()
    assert finish(*(start(script, SOFT_TENDON_ENV_QUIET="1") for _ in range(2)))[1] == ["", ""]


def is_locked(folder):
    return lambda: bool(list(folder.rglob(kernel_folder.LOCK)))


@pytest.mark.slow
@pytest.mark.parametrize("end", [signal.SIGTERM, signal.SIGINT])
def test_the_one_that_waits_takes_over_from_one_that_is_killed(start, tmp_path, end, two_kernels, slowly):
    first = start(slowly(two_kernels, 60.0))
    wait_until(is_locked(tmp_path / "cache"))
    second = start(slowly(two_kernels, 0.0))
    time.sleep(1.0)
    first.send_signal(end)
    assert finish(second)[0] == [COMPILED]
    assert not leftovers(tmp_path / "cache")


def test_who_waits_can_be_interrupted_and_takes_over_from_one_that_was_stopped(start, tmp_path, two_kernels, slowly):
    first = start(slowly(two_kernels, 60.0))
    wait_until(is_locked(tmp_path / "cache"))
    first.send_signal(signal.SIGSTOP)
    interrupted = start(slowly(two_kernels, 0.0, SECONDS_BEFORE_LINE=0.1))
    assert "waiting" in interrupted.stderr.readline()
    interrupted.send_signal(signal.SIGINT)
    interrupted.communicate(timeout=30)
    assert interrupted.returncode == -signal.SIGINT
    (stdout,), (stderr,) = finish(start(slowly(two_kernels, 0.0, SECONDS_BEFORE_LINE=0.1, PATIENCE=1.0)))
    assert stdout == COMPILED and stderr.count("compiling here too") == 1
    assert re.search("another process has compiled for [0-9]+ s: compiling here too", stderr)


def test_a_kernel_that_cannot_be_compiled_is_left_to_others(tmp_path, monkeypatch):
    folder = KernelFolder(tmp_path)
    monkeypatch.setattr(kernel_cache, "kernel_folder", lambda: folder)

    @kernel
    def adds_text(x):
        return x + "text"

    for _ in range(2):
        with pytest.raises(TypingError):
            adds_text(1.0)
        assert not machine_code(tmp_path) and not leftovers(tmp_path)


def test_without_locks_every_process_compiles(start, two_kernels, problems, slowly):
    no_locks = """
import fcntl, errno
def flock(*_):
    raise OSError(errno.ENOLCK, "No locks available")
fcntl.flock = flock
"""
    stdout, stderr = finish(*(start(no_locks + slowly(two_kernels, 0.5, together=2)) for _ in range(2)))
    assert stdout == [COMPILED] * 2 and [problems(text) for text in stderr] == [[], []]


CALLS = {1: (0, 0), 2: (0, 1), 3: (0, 2), 4: (1, 3), 5: (2, 3), 6: (4, 5), 7: (3, 6)}
MANY = f"""
import random, threading
from soft_tendon_env.compiler.compilation import kernel

@kernel
def k0(x):
    return x + 1.0
{"".join(f"@kernel{chr(10)}def k{i}(x):{chr(10)}    return k{a}(x) + k{b}(x){chr(10)}" for i, (a, b) in CALLS.items())}
kernels = [k0, {", ".join(f"k{i}" for i in CALLS)}]
order = random.sample(range(len(kernels)), len(kernels))
halves = [threading.Thread(target=lambda part=part: [kernels[i](1.0) for i in part]) for part in (order[::2], order[1::2])]
for half in halves:
    half.start()
for half in halves:
    half.join()
print(kernels[-1](1.0), sum(sum(kernel.stats.cache_misses.values()) for kernel in kernels))
"""


@pytest.mark.slow
def test_processes_and_threads_in_any_order_never_wait_for_each_other(start, slowly):
    """Kernels that call one another, begun from everywhere at once."""
    stdout, _ = finish(*(start(slowly(MANY, 0.1, together=4)) for _ in range(4)))
    results, compiled = zip(*(text.split() for text in stdout), strict=True)
    assert len(set(results)) == 1
    assert sum(map(int, compiled)) == 1 + len(CALLS), "compiled twice"
