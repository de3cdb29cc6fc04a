"""The decorator, the cache folder and what is said on stderr.

What happens at first use happens once per process, so these tests start their own, with their own cache folder.
"""

import os
import re
import subprocess
import sys
from pathlib import Path

import numba
import pytest

from soft_tendon_env import compilation
from soft_tendon_env.compilation import FOLDERS_KEPT, KERNEL_SOURCES, PACKAGE, kernel, open_cache, source_digest

TWO_KERNELS = """
from soft_tendon_env.compilation import kernel

@kernel(inline=True)
def square(x):
    return x * x

@kernel
def sum_of_squares(n):
    total = 0.0
    for i in range(n):
        total += square(i)
    return total

print(sum_of_squares(4), type(sum_of_squares).__name__)
"""

WITH_EVERY_LINE = "import soft_tendon_env.compilation as compilation; compilation.NOTICEABLE = 0.0\n" + TWO_KERNELS


@pytest.fixture
def run(tmp_path):
    """Run a script in a process of its own: `run(script, NAME="value")` -> the finished process."""

    def run(script: str, **variables: str) -> subprocess.CompletedProcess[str]:
        file = tmp_path / "script.py"
        if not file.exists():  # a test runs one script; some versions of numba take a file written again for a new one
            file.write_text(script)
        inherited = {name: value for name, value in os.environ.items() if not name.startswith(("NUMBA_", "SOFT_TENDON_ENV_", "XDG_"))}
        package_parent = str(compilation.PACKAGE.parent)
        environment = {**inherited, "PYTHONPATH": package_parent, "XDG_CACHE_HOME": str(tmp_path / "cache"), **variables}
        return subprocess.run([sys.executable, file], env=environment, capture_output=True, text=True, check=True)

    return run


def machine_code(folder: Path) -> list[str]:
    """The names of the functions whose machine code lies below the folder."""
    return sorted(path.name.split("-")[0] for path in folder.rglob("*.nbc"))


def test_first_process_compiles_and_says_so_second_is_silent(run, tmp_path):
    first, second = run(TWO_KERNELS), run(TWO_KERNELS)
    assert first.stdout == second.stdout == "14.0 CPUDispatcher\n"
    assert first.stderr.count("compiling for first use") == 1
    assert str(tmp_path / "cache" / "soft_tendon_env") in first.stderr
    assert second.stderr == ""
    assert machine_code(tmp_path / "cache") == ["script.square", "script.sum_of_squares"]


def test_progress_counts_nested_functions_once(run):
    assert "compiled 2 functions, " in run(WITH_EVERY_LINE).stderr


def test_silenced_by_the_environment(run, tmp_path):
    assert run(TWO_KERNELS, SOFT_TENDON_ENV_QUIET="1").stderr == ""
    assert machine_code(tmp_path / "cache")


def test_without_jit_a_kernel_is_the_plain_function(run, tmp_path):
    process = run(TWO_KERNELS, NUMBA_DISABLE_JIT="1")
    assert (process.stdout, process.stderr) == ("14.0 function\n", "")
    assert not (tmp_path / "cache").exists()


def test_numba_cache_dir_of_the_user_comes_first(run, tmp_path):
    run(TWO_KERNELS, NUMBA_CACHE_DIR=str(tmp_path / "chosen"))
    assert machine_code(tmp_path / "chosen" / "soft_tendon_env")
    assert not (tmp_path / "cache").exists()


def test_unwritable_cache_falls_back_with_a_warning(run, tmp_path):
    file_in_the_way = tmp_path / "file"
    file_in_the_way.touch()
    process = run(TWO_KERNELS, XDG_CACHE_HOME=str(file_in_the_way), HOME=str(file_in_the_way), TMPDIR=str(tmp_path))
    assert process.stdout == "14.0 CPUDispatcher\n"
    assert "set NUMBA_CACHE_DIR to a writable folder" in process.stderr
    assert not list(tmp_path.glob("soft_tendon_env-*")), "the temporary folder outlives the process"


def test_caches_of_other_packages_stay_where_they_were():
    before = numba.config.CACHE_DIR
    kernel(lambda x: x)
    assert numba.config.CACHE_DIR == before
    with pytest.raises(TypeError):
        kernel("not a function")
    assert numba.config.CACHE_DIR == before


@pytest.fixture
def package(tmp_path):
    folder = tmp_path / "package"
    (folder / "mechanics").mkdir(parents=True)
    (folder / "__init__.py").write_text("")
    (folder / "mechanics" / "lie.py").write_text("a = 1\n")
    return folder


def test_digest_depends_on_the_sources_alone(package, tmp_path):
    copy = tmp_path / "elsewhere"
    package.rename(copy)
    before = source_digest(copy)
    copy.rename(package)
    (package / "notes.txt").write_text("not a source")
    (package / "model.py").write_text("no kernel is made from this")
    (package / "mechanics" / "lie.py").touch()
    assert source_digest(package) == before


@pytest.mark.parametrize(
    "change",
    [
        lambda package: (package / "mechanics" / "lie.py").write_text("a = 2\n"),
        lambda package: (package / "mechanics" / "lie.py").rename(package / "mechanics" / "groups.py"),
        lambda package: (package / "mechanics" / "lie.py").unlink(),
        lambda package: (package / "mechanics" / "new.py").write_text(""),
    ],
    ids=["edited", "moved", "removed", "added"],
)
def test_digest_changes_with_any_source(package, change):
    before = source_digest(package)
    change(package)
    assert source_digest(package) != before


def test_every_kernel_of_the_package_is_in_the_digest():
    covered = {source for pattern in KERNEL_SOURCES for source in PACKAGE.glob(pattern)}
    with_kernels = {source for source in PACKAGE.rglob("*.py") if re.search(r"^\s*@kernel\b", source.read_text(), re.MULTILINE)}
    assert with_kernels and with_kernels <= covered
    for source in covered:  # and nothing that lies elsewhere goes into one; configurations are read before kernels run
        imported = re.findall(r"^\s*from soft_tendon_env\.(\w+)", source.read_text(), re.MULTILINE)
        assert set(imported) <= {"compilation", "mechanics", "effects", "configuration"}, source


def test_digest_changes_with_the_compiler_and_its_switches(package, monkeypatch):
    digests = [source_digest(package)]
    monkeypatch.setattr(numba, "__version__", "0.0")
    digests.append(source_digest(package))
    monkeypatch.setattr(numba.config, "BOUNDSCHECK", 1)
    digests.append(source_digest(package))
    assert len(set(digests)) == 3


def test_only_the_versions_used_last_are_kept(tmp_path):
    digests = [f"{number:016x}" for number in range(FOLDERS_KEPT + 2)]
    for age, digest in enumerate(digests):
        folder = open_cache(tmp_path, digest)
        os.utime(folder, (age, age))  # 1970, the later digests later
    (tmp_path / "not-ours").mkdir()
    open_cache(tmp_path, digests[-2])  # used again, so the newest now
    open_cache(tmp_path, "f" * 16)
    assert sorted(path.name for path in tmp_path.iterdir()) == sorted([digests[-2], digests[-1], "f" * 16, "not-ours"])
