"""Locks between processes: one holds, the others see who; whoever ends lets go."""

import fcntl
import os
import subprocess
import sys

import pytest

from soft_tendon_env.compiler.file_lock import try_lock, unlock
from soft_tendon_env.compiler.kernel_cache import PACKAGE

HOLDS = """
import sys
from pathlib import Path
from soft_tendon_env.compiler.file_lock import try_lock
print(try_lock(Path(sys.argv[1]), "another one") is not None, flush=True)
sys.stdin.read()
"""


@pytest.fixture
def other(tmp_path):
    """other(): a process that tries the lock "held" once, and whether it got it; it holds it until it is killed."""
    processes = []

    def start():
        command = [sys.executable, "-c", HOLDS, str(tmp_path / "held")]
        environment = {**os.environ, "PYTHONPATH": str(PACKAGE.parent), "NUMBA_DISABLE_JIT": "1"}
        processes.append(subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True, env=environment))
        return processes[-1], processes[-1].stdout.readline() == "True\n"

    yield start
    for process in processes:
        process.kill()
        process.communicate()


def test_one_holds_and_says_who(other, tmp_path):
    path = tmp_path / "held"
    mine = try_lock(path, "me")
    assert mine is not None and os.pread(mine, 10, 0) == b"me"
    assert not other()[1]
    unlock(path, mine)
    assert not path.exists()
    process, got = other()
    assert got and path.read_text() == "another one" and try_lock(path, "me") is None
    process.kill()
    process.wait()
    mine = try_lock(path, "me")
    assert mine is not None and os.pread(mine, 10, 0) == b"me"
    unlock(path, mine)


def test_a_forked_child_holds_nothing(other, tmp_path):
    """It has the parent's file open, but what it closes is its own."""
    path = tmp_path / "held"
    mine = try_lock(path, "me")
    child = os.fork()
    if child == 0:
        os.close(mine)
        os._exit(0)
    assert os.waitpid(child, 0)[1] == 0
    assert not other()[1]
    unlock(path, mine)
    assert other()[1]


def test_a_file_that_its_holder_removes_meanwhile_is_not_taken_for_the_lock(tmp_path, monkeypatch):
    """Between opening and locking."""
    path, lock = tmp_path / "held", fcntl.lockf
    removed = []

    def late(*arguments):
        if not removed:
            removed.append(path.unlink())
        lock(*arguments)

    monkeypatch.setattr(fcntl, "lockf", late)
    mine = try_lock(path, "me")
    assert mine is not None and os.path.samestat(os.fstat(mine), path.stat())
    unlock(path, mine)


def test_where_nothing_can_be_locked_it_says_so(tmp_path, monkeypatch):
    open_files = set(os.listdir("/proc/self/fd"))
    with pytest.raises(FileNotFoundError):
        try_lock(tmp_path / "none" / "held", "me")
    monkeypatch.setattr(os.path, "samestat", lambda *_: False)
    with pytest.raises(OSError, match="another file each time"):
        try_lock(tmp_path / "held", "me")
    assert set(os.listdir("/proc/self/fd")) == open_files
