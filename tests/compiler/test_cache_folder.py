"""Which folder the machine code lies in, and that it changes with whatever decides which code is right."""

import os
import re
import stat

import numba

from soft_tendon_env.compiler.cache_folder import FOLDERS_KEPT, PACKAGE, kernel_sources, open_folder, source_digest

COMPILED, LOADED = "14.0 1\n", "14.0 0\n"


def machine_code(folder):
    return sorted(folder.rglob("*.nbc"))


def test_numba_cache_dir_of_the_user_comes_first(run, tmp_path, two_kernels, problems):
    process = run(two_kernels, NUMBA_CACHE_DIR=str(tmp_path / "chosen"))
    assert machine_code(tmp_path / "chosen" / "soft_tendon_env") and not problems(process.stderr)
    assert not (tmp_path / "cache").exists()


def test_a_folder_that_cannot_be_written_is_passed_over_and_named(run, tmp_path, two_kernels, problems):
    chosen = tmp_path / "file"
    chosen.touch()
    (line,) = problems(run(two_kernels, NUMBA_CACHE_DIR=str(chosen)).stderr)
    assert f"NUMBA_CACHE_DIR={chosen} cannot be used (Not a directory)" in line
    assert f"is kept in {tmp_path / 'cache'}" in line and "set NUMBA_CACHE_DIR" in line
    assert machine_code(tmp_path / "cache")


def test_without_a_home_the_temporary_files_do(run, tmp_path, two_kernels, problems):
    """As in containers, with a home that cannot be written."""
    variables = {"XDG_CACHE_HOME": None, "HOME": "/proc/none", "TMPDIR": str(tmp_path)}
    first, second = run(two_kernels, **variables), run(two_kernels, **variables)
    assert (first.stdout, second.stdout) == (COMPILED, LOADED)
    own = tmp_path / f"soft_tendon_env-{os.getuid()}"
    (line,) = problems(first.stderr)
    assert "~/.cache cannot be used" in line and f"is kept in {own}" in line and "set NUMBA_CACHE_DIR" in line
    assert problems(second.stderr) == [line] and machine_code(own) and stat.S_IMODE(own.stat().st_mode) == 0o700


def test_machine_code_is_not_loaded_from_a_folder_that_others_can_write(run, tmp_path, two_kernels):
    own = tmp_path / f"soft_tendon_env-{os.getuid()}"
    own.mkdir()
    own.chmod(0o777)
    process = run(two_kernels, XDG_CACHE_HOME=None, HOME="/proc/none", TMPDIR=str(tmp_path))
    assert process.stdout == COMPILED and not machine_code(own)
    assert "others can write" in process.stderr


def test_every_kernel_of_the_package_is_in_the_digest():
    """But for effects, which code_digest.py follows."""
    covered, effects = set(kernel_sources(PACKAGE)), set(PACKAGE.glob("effects/**/*.py"))
    with_kernels = {source for source in PACKAGE.rglob("*.py") if re.search(r"^\s*@kernel\b", source.read_text(), re.MULTILINE)}
    assert with_kernels and with_kernels <= covered | effects
    for source in covered | effects:  # and nothing that lies elsewhere goes into one; configurations are read before kernels run
        imported = re.findall(r"^\s*from soft_tendon_env\.(tools\.\w+|\w+)", source.read_text(), re.MULTILINE)
        tools = ("messages", "configuration", "types", "versions")  # which choose no code
        assert set(imported) <= {*(f"tools.{name}" for name in tools), "compiler", "mechanics", "effects"}, source


def test_the_digest_changes_with_a_source_and_with_the_compiler(tmp_path, monkeypatch):
    (tmp_path / "mechanics").mkdir()
    (tmp_path / "mechanics" / "lie.py").write_text("a = 1\n")
    digests = [source_digest(tmp_path)]
    (tmp_path / "model.py").write_text("no kernel is made from this")
    assert source_digest(tmp_path) == digests[0]
    (tmp_path / "mechanics" / "lie.py").write_text("a = 2\n")
    digests.append(source_digest(tmp_path))
    monkeypatch.setattr(numba, "__version__", "0.0")
    digests.append(source_digest(tmp_path))
    assert len(set(digests)) == 3


def test_only_the_versions_used_last_are_kept(tmp_path):
    digests = [f"{number:016x}" for number in range(FOLDERS_KEPT + 2)]
    for age, digest in enumerate(digests):
        folder = open_folder(tmp_path, digest)
        os.utime(folder, (age, age))  # 1970, the later digests later
    (tmp_path / "not-ours").mkdir()
    open_folder(tmp_path, digests[-2])  # used again, so the newest now
    open_folder(tmp_path, "f" * 16)
    assert sorted(path.name for path in tmp_path.iterdir()) == sorted([digests[-2], digests[-1], "f" * 16, "not-ours"])
