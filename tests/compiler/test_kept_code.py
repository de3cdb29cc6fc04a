"""Machine code on disk that was damaged, or that cannot be written: kernels are compiled anew, with
one line that names the folder."""

import errno
import os
import pickle
import shutil

import pytest
from numba import config

from soft_tendon_env.compiler import compilation
from soft_tendon_env.compiler.compilation import OPTIONS, Kernel
from soft_tendon_env.compiler.kept_code import KeptCode
from soft_tendon_env.tools import messages

pytestmark = pytest.mark.skipif(bool(config.DISABLE_JIT), reason="nothing is compiled")

NO_SUCH_CLASS = b"cno_such_module\nNoSuchClass\n."
"""A pickle that names a class which does not exist."""


def half(content):
    return content[: len(content) // 2]


def with_other_bytes_inside(content):
    middle = len(content) // 2
    return content[:middle] + bytes(64) + content[middle + 64 :]


DAMAGE = {
    "half": half,
    "empty": lambda content: b"",
    "foreign bytes": lambda content: bytes(range(256)),
    "other bytes inside": with_other_bytes_inside,
    "another pickle": lambda content: pickle.dumps(["another", "pickle"]),
    "missing class": lambda content: NO_SUCH_CLASS,
}


def scale(x, factor):
    return factor * x


def shift(x, distance):
    return x + distance


def twice(x):
    """What a kernel of its own returns, as in a new process."""
    messages.warn_once.cache_clear()
    messages.say_once.cache_clear()
    return Kernel(scale, OPTIONS).call(x, 2.0)


@pytest.fixture
def cache(tmp_path, monkeypatch, capsys):
    """A cache folder with machine code of a kernel for two types."""
    folder = tmp_path / "cache"
    folder.mkdir()
    monkeypatch.setattr(compilation, "cache_folder", lambda: folder)
    assert (twice(1.0), twice(1)) == (2.0, 2.0)
    capsys.readouterr()
    return folder


def kept_code(cache):
    """The files of the only kernel."""
    return KeptCode(next(path for path in cache.iterdir() if path.is_dir()))


def is_mended(cache, capsys):
    """Whether a kernel works with one line on the damage, and then with none."""
    line = f"soft_tendon_env: machine code in {cache} is damaged: compiling it anew\n"
    for expected in (line, ""):
        assert twice(1) == 2.0
        assert capsys.readouterr().err.replace(progress(cache), "") == expected
    return True


def progress(cache):
    return f"soft_tendon_env: compiling for first use (cached in {cache}; once per version)\n"


@pytest.mark.parametrize("suffix", ["nbi", "nbc"])
@pytest.mark.parametrize("damage", list(DAMAGE.values()))
def test_a_damaged_file_is_replaced(suffix, damage, cache, capsys):
    for file in cache.rglob(f"*.{suffix}"):
        file.write_bytes(damage(file.read_bytes()))
    assert is_mended(cache, capsys)


@pytest.mark.parametrize("damage", list(DAMAGE.values())[:3])
def test_damaged_digests_are_replaced(damage, cache, capsys):
    file = next(cache.glob("*.json"))
    file.write_bytes(damage(file.read_bytes()))
    assert is_mended(cache, capsys)


@pytest.mark.parametrize("is_sealed", [False, True])
def test_machine_code_for_other_arguments_is_replaced(is_sealed, cache, capsys):
    """Two processes may have saved at once, where folders have no locks."""
    assert (twice(1.0), twice(1)) == (2.0, 2.0)
    capsys.readouterr()
    files = sorted(cache.rglob("*.nbc"))
    contents = [file.read_bytes() for file in files]
    for file, content in zip(files, reversed(contents), strict=True):
        file.write_bytes(content)
    if is_sealed:
        kept_code(cache).seal()
    assert is_mended(cache, capsys)


@pytest.mark.parametrize("suffix", ["nbi", "nbc"])
def test_what_numba_cannot_read_is_replaced(suffix, cache, capsys):
    """The files are those that were written, by another version of a library."""
    for file in cache.rglob(f"*.{suffix}"):
        file.write_bytes(NO_SUCH_CLASS)
    kept_code(cache).seal()
    assert is_mended(cache, capsys)


def test_a_file_in_place_of_a_folder_is_replaced(cache, capsys):
    folder = next(cache.rglob("*.nbi")).parent
    shutil.rmtree(folder)
    folder.touch()
    assert is_mended(cache, capsys)


def test_files_that_may_not_be_read_are_replaced(cache, capsys):
    for file in cache.rglob("*.nb?"):
        file.chmod(0)
        if os.access(file, os.R_OK):
            pytest.skip("the superuser may read all")
    assert is_mended(cache, capsys)


@pytest.mark.parametrize("error", [errno.ENOSPC, errno.EROFS, errno.EACCES])
def test_a_kernel_that_cannot_be_kept_runs(error, cache, capsys, monkeypatch):
    """A full disk, or a folder that has become read-only, when machine code is saved."""

    def refuse(source, target):
        raise OSError(error, os.strerror(error), target)

    with monkeypatch.context() as refusing:
        refusing.setattr(os, "replace", refuse)
        assert Kernel(scale, OPTIONS).call(1.0, 2) == 2.0
        assert Kernel(shift, OPTIONS).call(1.0, 2) == 3.0
    lines = capsys.readouterr().err
    assert lines.count(f"machine code is not kept in {cache}") == 1, "not one for each kernel"
    assert os.strerror(error) in lines
    assert "damaged" not in lines
