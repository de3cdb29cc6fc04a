"""Time that a compilation still takes, by a clock that the test moves."""

import os
import re
import subprocess
import sys
from types import SimpleNamespace

import pytest
from numba import config

import soft_tendon_env as ste
from soft_tendon_env.model import compilation_progress
from soft_tendon_env.model.compilation_progress import (
    ADDED,
    ADDED_BY_OTHERS,
    GROWTH,
    KERNELS,
    CompilationProgress,
)
from soft_tendon_env.tools.messages import say_once

pytestmark = pytest.mark.no_jit

DURATION = 100.0
"""Time [s] that the compilation of all kernels takes."""

OF_PACKAGE = compilation_progress._is_kernel


def compile_all(function, scene="three_tendon", kernels=KERNELS):
    """Compiles one kernel that calls all others, each in the share of time that it is taken for."""
    time = 0.0
    progress = CompilationProgress(clock=lambda: time)
    progress.concerns(ste.load_scene(scene))
    event = SimpleNamespace(data={"dispatcher": SimpleNamespace(py_func=function)})
    progress.on_start(event)
    for done in range(1, kernels):
        progress.on_start(event)
        time = DURATION * (done / kernels) ** GROWTH
        progress.on_end(event)
    progress.on_end(event)


@pytest.fixture(autouse=True)
def _said_anew():
    say_once.cache_clear()
    yield
    say_once.cache_clear()


@pytest.mark.parametrize(
    ("scene", "kernels"),
    [
        ("three_tendon", KERNELS),
        ("underwater", KERNELS + ADDED_BY_OTHERS),
        ("paper_among_obstacles", KERNELS + ADDED["contact"]),
    ],
)
def test_the_time_to_go_is_what_is_left(scene, kernels, monkeypatch, capsys):
    monkeypatch.setattr(compilation_progress, "_any_kept", lambda: False)
    compile_all(OF_PACKAGE, scene, kernels)
    lines = capsys.readouterr().err.splitlines()
    assert len(lines) == 6  # after 10, 15, 23, 34, 51 and 76 s
    for line in lines:
        assert line.startswith(f"soft_tendon_env: scene '{scene}': ")
        done, of, to_go = map(int, re.findall(r"\d+", line))
        assert of == kernels
        left = DURATION * (1.0 - (done / kernels) ** GROWTH)
        assert to_go == pytest.approx(left, abs=1.0)


@pytest.mark.parametrize(
    ("kept", "function"), [(True, OF_PACKAGE), (False, test_the_time_to_go_is_what_is_left)]
)
def test_nothing_is_said_where_it_is_not_known(kept, function, monkeypatch, capsys):
    """Namely where some kernels were kept, and of functions of users."""
    monkeypatch.setattr(compilation_progress, "_any_kept", lambda: kept)
    compile_all(function)
    assert capsys.readouterr().err == ""


FIRST_STEP = """
import gymnasium as gym
import soft_tendon_env
from soft_tendon_env.model.compilation_progress import PROGRESS

env = gym.make("TendonRod-TipPose-v0", scene="three_tendon")
env.reset(seed=0)
env.step(env.action_space.sample())
print(PROGRESS._done)
"""


@pytest.mark.slow
@pytest.mark.skipif(bool(config.DISABLE_JIT), reason="nothing is compiled")
def test_a_first_step_needs_about_as_many_kernels_as_are_told(tmp_path):
    """From an empty cache. The number depends a little on the scene and on what its trial needs."""
    environment = {**os.environ, "XDG_CACHE_HOME": str(tmp_path)}
    process = subprocess.run(
        [sys.executable, "-c", FIRST_STEP],
        env=environment,
        capture_output=True,
        text=True,
        check=True,
    )
    assert int(process.stdout) == pytest.approx(KERNELS, rel=0.2)
