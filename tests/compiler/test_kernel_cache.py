"""Kernels and their files: who compiles and says so, what is loaded, and what becomes of broken and of unwritable files.

numba is started in processes of their own, with small kernels.
"""

import errno
import os
import signal
import time

import pytest

from soft_tendon_env.compiler import kernel_folder
from soft_tendon_env.compiler.kernel_folder import KernelFolder

COMPILED, LOADED = "14.0 1\n", "14.0 0\n"
FULL_DISK = """
import resource, signal
signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
resource.setrlimit(resource.RLIMIT_FSIZE, (2000, 2000))
"""


def machine_code(folder):
    return sorted(folder.rglob("*.nbc"))


def leftovers(folder):
    """Files below the folder that are no machine code."""
    return [path for path in folder.rglob("*") if path.is_file() and path.suffix != ".nbc" and path.name != kernel_folder.LOCK]


def finish(*processes):
    """Their texts on stdout and on stderr."""
    texts = [process.communicate(timeout=60) for process in processes]
    assert [process.returncode for process in processes] == [0] * len(processes), texts
    return [text[0] for text in texts], [text[1] for text in texts]


def test_the_first_process_compiles_and_says_so_and_the_second_loads_in_silence(run, tmp_path, two_kernels):
    every_line = "from soft_tendon_env.compiler import compilation_progress as lines; lines.NOTICEABLE = 0.0\n"
    first, second = run(every_line + two_kernels), run(every_line + two_kernels)
    assert (first.stdout, second.stdout, second.stderr) == (COMPILED, LOADED, "")
    assert first.stderr.count("compiling for first use") == 1 and "compiled 2 functions, " in first.stderr
    assert str(tmp_path / "cache" / "soft_tendon_env") in first.stderr


def test_a_changed_kernel_is_compiled_again_in_the_same_file(run, tmp_path, two_kernels):
    run(two_kernels)
    before = machine_code(tmp_path / "cache")
    assert run(two_kernels.replace("x * x", "x * 2")).stdout == "12.0 1\n"
    assert machine_code(tmp_path / "cache") == before


def test_kernels_that_are_alike_are_told_apart(run):
    """Signatures, closures, and lambdas of one line, by their constants alone."""
    script = """
from soft_tendon_env.compiler.compilation import kernel
def times(factor):
    return kernel(lambda x: factor * x)
print([times(factor)(x) for factor in (2, 3) for x in (1, 1.5)])
print([f(1) for f in (kernel(lambda x: 2 * x), kernel(lambda x: 3 * x))])
"""
    assert [run(script).stdout for _ in range(2)] == ["[2, 3.0, 3, 4.5]\n[2, 3]\n"] * 2


def test_a_full_disk_is_said_once_and_leaves_nothing(run, tmp_path, two_kernels, problems):
    process = run(FULL_DISK + two_kernels)
    (line,) = problems(process.stderr)
    assert process.stdout == COMPILED and "File too large" in line and str(tmp_path / "cache") in line and "NUMBA_CACHE_DIR" in line
    assert not machine_code(tmp_path / "cache") and not leftovers(tmp_path / "cache")
    assert [run(two_kernels).stdout for _ in range(2)] == [COMPILED, LOADED]


@pytest.mark.cases("number", [errno.ENOSPC, errno.EROFS, errno.EIO])
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


DAMAGE = {
    "empty": lambda content: b"", "cut in half": lambda content: content[: len(content) // 2], "too long": lambda content: content + b"x",
    "zeros at the end": lambda content: content[:-1000] + bytes(1000), "text": lambda content: b"no machine code",
    "a bit": lambda content: content[:5000] + bytes([content[5000] ^ 1]) + content[5001:],
}  # fmt: skip


@pytest.mark.cases("damage", [*DAMAGE])
def test_files_that_were_cut_or_damaged_are_deleted_and_named_once(tmp_path, capsys, damage, problems):
    folder, names = KernelFolder(tmp_path / damage), ("one.nbc", "two.nbc")
    for name in names:
        folder.write(name, bytes(range(256)) * 40)
        file = tmp_path / damage / name
        file.write_bytes(DAMAGE[damage](file.read_bytes()))
        assert folder.read(name) is None and not file.exists()
    (line,) = problems(capsys.readouterr().err)
    assert "broken machine code" in line and names[0] in line and "compiled again" in line


def test_broken_machine_code_is_compiled_again(run, tmp_path, two_kernels, problems):
    run(two_kernels)
    for file in machine_code(tmp_path / "cache"):
        file.write_bytes(DAMAGE["a bit"](file.read_bytes()))
    process = run(two_kernels)
    assert process.stdout == COMPILED and len(problems(process.stderr)) == 1
    assert run(two_kernels).stdout == LOADED


def test_of_two_processes_one_compiles_and_the_other_waits_and_says_so(start, tmp_path, two_kernels, slowly):
    script = slowly(two_kernels, 1.0, together=2, SECONDS_BEFORE_LINE=0.1)
    stdout, stderr = finish(*(start(script) for _ in range(2)))
    assert sorted(stdout) == [LOADED, COMPILED]
    assert stderr[stdout.index(LOADED)] == "soft_tendon_env: waiting for another process, which compiles\n"
    assert "waiting" not in stderr[stdout.index(COMPILED)] and not leftovers(tmp_path / "cache")


def test_who_waits_takes_over_from_one_that_was_killed(start, tmp_path, two_kernels, slowly):
    first, end = start(slowly(two_kernels, 60.0)), time.monotonic() + 30.0
    while not list((tmp_path / "cache").rglob(kernel_folder.LOCK)):
        assert time.monotonic() < end
        time.sleep(0.01)
    second = start(slowly(two_kernels, 0.0))
    time.sleep(1.0)
    first.send_signal(signal.SIGKILL)
    assert finish(second)[0] == [COMPILED] and not leftovers(tmp_path / "cache")


def test_silenced_by_the_environment(run, two_kernels):
    assert run(two_kernels, SOFT_TENDON_ENV_QUIET="1").stderr == ""


def test_without_jit_a_kernel_is_the_plain_function(run, tmp_path, two_kernels):
    plain = two_kernels.replace("sum(sum_of_squares.stats.cache_misses.values())", "type(sum_of_squares).__name__")
    process = run(plain, NUMBA_DISABLE_JIT="1")
    assert (process.stdout, process.stderr) == ("14.0 function\n", "")
    assert not (tmp_path / "cache").exists()
