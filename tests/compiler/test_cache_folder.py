"""Which folder the machine code lies in, and that it changes with whatever decides which code is right."""

import os
import re
import stat

import numba
import pytest

from soft_tendon_env.compiler.cache_folder import FOLDERS_KEPT, PACKAGE, kernel_sources, open_folder, source_digest

COMPILED, LOADED = "14.0 1\n", "14.0 0\n"


def machine_code(folder):
    return sorted(folder.rglob("*.nbc"))


def test_numba_cache_dir_of_the_user_comes_first(run, tmp_path, two_kernels, problems):
    process = run(two_kernels, NUMBA_CACHE_DIR=str(tmp_path / "chosen"))
    assert machine_code(tmp_path / "chosen" / "soft_tendon_env") and not problems(process.stderr)
    assert not (tmp_path / "cache").exists()


def test_a_relative_folder_stays_where_it_was(run, tmp_path, two_kernels):
    script = f"import os; os.chdir({str(tmp_path)!r}); import soft_tendon_env.compiler.compilation; os.chdir('/')\n" + two_kernels
    assert run(script, NUMBA_CACHE_DIR="chosen").stdout == COMPILED
    assert machine_code(tmp_path / "chosen" / "soft_tendon_env")


def test_a_folder_that_cannot_be_written_is_passed_over_and_named(run, tmp_path, two_kernels, problems):
    in_the_way = tmp_path / "file"
    in_the_way.touch()
    for chosen in (in_the_way, in_the_way / "below"):
        (line,) = problems(run(two_kernels, NUMBA_CACHE_DIR=str(chosen)).stderr)
        assert f"NUMBA_CACHE_DIR={chosen} cannot be used (Not a directory)" in line
        assert f"is kept in {tmp_path / 'cache'}" in line and "set NUMBA_CACHE_DIR" in line
    assert machine_code(tmp_path / "cache")


NO_HOME = "import pwd\ndef nobody(_): raise KeyError\npwd.getpwuid = nobody\n"


@pytest.mark.parametrize("home", ["/proc/none", None], ids=["unwritable", "none"])
def test_without_a_home_the_temporary_files_do(run, tmp_path, home, two_kernels, problems):
    """As in containers, with a home that cannot be written, or with users that have none."""
    variables = {"XDG_CACHE_HOME": None, "HOME": home, "TMPDIR": str(tmp_path)}
    first, second = run(NO_HOME + two_kernels, **variables), run(NO_HOME + two_kernels, **variables)
    assert (first.stdout, second.stdout) == (COMPILED, LOADED)
    own = tmp_path / f"soft_tendon_env-{os.getuid()}"
    (line,) = problems(first.stderr)
    assert "~/.cache cannot be used" in line and f"is kept in {own}" in line and "set NUMBA_CACHE_DIR" in line
    assert problems(second.stderr) == [line] and machine_code(own) and stat.S_IMODE(own.stat().st_mode) == 0o700


def test_without_any_folder_every_process_compiles(run, two_kernels, problems):
    nowhere = "import tempfile; tempfile.tempdir = '/proc/none'\n"
    for _ in range(2):
        process = run(nowhere + two_kernels, XDG_CACHE_HOME=None, HOME="/proc/none")
        assert process.stdout == COMPILED
        (line,) = problems(process.stderr)
        assert "~/.cache cannot be used" in line and "temporary files" in line
        assert "compiles again" in line and "set NUMBA_CACHE_DIR" in line


def test_machine_code_is_not_loaded_from_a_folder_that_others_can_write(run, tmp_path, two_kernels):
    own = tmp_path / f"soft_tendon_env-{os.getuid()}"
    own.mkdir()
    own.chmod(0o777)
    process = run(two_kernels, XDG_CACHE_HOME=None, HOME="/proc/none", TMPDIR=str(tmp_path))
    assert process.stdout == COMPILED and not machine_code(own)
    assert "others can write" in process.stderr


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
    """But for effects, which code_digest.py follows."""
    covered, effects = set(kernel_sources(PACKAGE)), set(PACKAGE.glob("effects/**/*.py"))
    with_kernels = {source for source in PACKAGE.rglob("*.py") if re.search(r"^\s*@kernel\b", source.read_text(), re.MULTILINE)}
    assert with_kernels and with_kernels <= covered | effects
    for source in covered | effects:  # and nothing that lies elsewhere goes into one; configurations are read before kernels run
        imported = re.findall(r"^\s*from soft_tendon_env\.(tools\.\w+|\w+)", source.read_text(), re.MULTILINE)
        tools = ("messages", "configuration", "types", "versions")  # which choose no code
        assert set(imported) <= {*(f"tools.{name}" for name in tools), "compiler", "mechanics", "effects"}, source


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
        folder = open_folder(tmp_path, digest)
        os.utime(folder, (age, age))  # 1970, the later digests later
    (tmp_path / "not-ours").mkdir()
    open_folder(tmp_path, digests[-2])  # used again, so the newest now
    open_folder(tmp_path, "f" * 16)
    assert sorted(path.name for path in tmp_path.iterdir()) == sorted([digests[-2], digests[-1], "f" * 16, "not-ours"])
