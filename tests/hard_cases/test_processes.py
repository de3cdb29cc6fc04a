"""Processes beside each other: forked ones, ones that compile the same, ones that are killed, and disks that fill up under them.

numba compiles for minutes and keeps what it has compiled for all processes to come. Nothing that goes wrong with those files, or with
whoever writes them, may reach a simulation.
"""

import os
import pickle
import re
import signal
import time

import numpy as np
import pytest

from soft_tendon_env.compiler.kernel_folder import LOCK
from soft_tendon_env.envs import TipPoseVectorEnv

LIMIT = """
import resource, signal
signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
resource.setrlimit(resource.RLIMIT_FSIZE, (2000, 2000))
"""


def result_of(process):
    """What a script with two kernels prints, and how many times it compiled the outer one."""
    stdout, stderr = process.communicate(timeout=60)
    assert process.returncode == 0, stderr
    value, compiled = stdout.split()
    return float(value), int(compiled), stderr


@pytest.mark.filterwarnings("ignore:.*multi-threaded, use of fork:DeprecationWarning")
def test_forked_while_threads_run(measured):
    """A fork copies a vector environment with its locks and queues, but none of its threads: data loaders and SubprocVecEnv do that.
    Expected: child and parent both go on from the same state, bit for bit, and each closes its own threads.
    """
    actions = np.random.default_rng(0).uniform(-1.0, 1.0, (20, 24, 3))
    env = TipPoseVectorEnv(24, threads=3, scene="three_tendon", fidelity="fast")
    env.reset(seed=0)
    env.step(actions[0])

    def steps():
        return np.array([env.step(action)[0] for action in actions])

    receive, send = os.pipe()
    child = os.fork()
    if child == 0:
        signal.alarm(60)
        with os.fdopen(send, "wb") as file:
            pickle.dump(steps(), file)
        env.close()
        os._exit(0)
    os.close(send)
    with os.fdopen(receive, "rb") as file:
        result = file.read()
    assert os.waitpid(child, 0)[1] == 0
    difference = np.abs(pickle.loads(result) - steps()).max()
    env.close()
    measured("child to parent", difference)
    assert difference == 0.0


def test_full_disk(run, two_kernels, problems, tmp_path, measured):
    """The disk, or the user's part of it, is full by the time that the first kernel is compiled, and machine code is cut off in the middle.
    Expected: the same results, one line on stderr with folder, cause and the variable to set, and nothing left over.
    """
    process = run(LIMIT + two_kernels)
    lines = problems(process.stderr)
    measured("lines on stderr", len(lines))
    assert process.stdout == "14.0 1\n" and len(lines) == 1
    assert "File too large" in lines[0] and str(tmp_path / "cache") in lines[0] and "NUMBA_CACHE_DIR" in lines[0]
    assert not [path for path in (tmp_path / "cache").rglob("*") if path.is_file() and path.name != LOCK]
    process = run(two_kernels)
    assert process.stdout == "14.0 1\n" and not problems(process.stderr)


@pytest.mark.slow
def test_machine_code_cut_anywhere(run, two_kernels, problems, measured):
    """A power cut leaves a file of machine code cut off, or with zeros at its end; half of an instruction may still run.
    Expected: wherever it was cut, the file is deleted, the kernel compiled again with the same result, and that is said once.
    """
    script = """
from pathlib import Path
(file,) = Path(sum_of_squares.stats.cache_path).glob("*sum_of_squares-*.nbc")
whole = file.read_bytes()
for cut in range(0, len(whole), (len(whole) - 1) // 40):
    for rest in (0, len(whole) - cut):
        file.write_bytes(whole[:cut] + bytes(rest))
        for _ in range(2):
            again = kernel(sum_of_squares.py_func)
            print(again(4), sum(again.stats.cache_misses.values()))
"""
    process = run(two_kernels + script)
    lines = process.stdout.splitlines()[1:]
    mended = [(cut, again) == ("14.0 1", "14.0 0") for cut, again in zip(lines[::2], lines[1::2], strict=True)]
    measured("cuts", len(mended))
    measured("mended", sum(mended))
    assert len(mended) > 80 and all(mended)
    assert len(problems(process.stderr)) == 1


@pytest.mark.parametrize("count", [2, 4])
def test_many_processes_on_a_cold_cache(start, slowly, two_kernels, measured, count):
    """The workers of a training start at once, and each finds that the kernels which it needs are compiled by nobody yet.
    Expected: one compiles, the others wait for it and say so, and load what it has compiled.
    """
    processes = [start(slowly(two_kernels, 1.0, together=count)) for _ in range(count)]
    values, compiled, texts = zip(*map(result_of, processes), strict=True)
    measured("compilations over those of one process", sum(compiled))
    assert set(values) == {14.0} and sum(compiled) == 1
    assert all(("waiting for another process" in text) != bool(own) for text, own in zip(texts, compiled, strict=True))


def test_killed_while_others_wait(start, slowly, two_kernels, tmp_path, measured):
    """The process that compiles is killed, and can tell nobody.
    Expected: one of those that wait takes over at once; nothing stays locked.
    """
    first = start(slowly(two_kernels, 1000.0))
    while not list((tmp_path / "cache").rglob("*.lock")):
        time.sleep(0.01)
    others = [start(slowly(two_kernels, 0.0)) for _ in range(2)]
    time.sleep(5.0)
    assert all(other.poll() is None for other in others)
    first.send_signal(signal.SIGKILL)
    killed = time.monotonic()
    values, compiled, _ = zip(*map(result_of, others), strict=True)
    measured("until both are done [s]", time.monotonic() - killed)
    assert set(values) == {14.0} and sum(compiled) == 1


def test_folder_dropped_under_a_running_process(run, two_kernels, problems, measured):
    """Only the folders of the versions used last are kept, and a process that runs for days may be of an older one.
    Expected: it goes on, and compiles and keeps what it still needs.
    """
    script = """
import shutil
from pathlib import Path
from soft_tendon_env.compiler.kernel_folder import kernel_folder
shutil.rmtree(kernel_folder().path)
print(sum_of_squares(2.0 > 1.0), len(list(Path(sum_of_squares.stats.cache_path).glob("*.nbc"))))
"""
    process = run(two_kernels + script)
    value, files = process.stdout.splitlines()[1].split()
    measured("files kept afterwards", int(files))
    assert float(value) == 0.0 and int(files) > 0 and not problems(process.stderr)
    assert not re.search("Error|Traceback", process.stderr)
