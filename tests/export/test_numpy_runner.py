"""The runner needs NumPy and the file alone, and says in one line what it cannot use."""

import shutil
import subprocess
import sys

import numpy as np
import pytest

pytest.importorskip("onnx")
pytest.importorskip("torch")

from soft_tendon_env.export import numpy_runner  # noqa: E402

CODE = """
import sys
sys.path.insert(0, ".")
import numpy as np, numpy_runner
agent = numpy_runner.Agent("agent.onnx")
command = agent(tip_pose=np.eye(4))
print(*command)
assert not {"soft_tendon_env", "onnx", "torch", "scipy", "numba"} & set(sys.modules)
"""


@pytest.fixture
def agent(exported):
    """A small agent's file, and what it may be told."""
    _, _, path = exported(observation=["tip_position", "command"], action="increment")
    return path, {"tip_pose": np.eye(4)}


def test_it_stands_alone(agent, tmp_path):
    path, _ = agent
    shutil.copy(numpy_runner.__file__, tmp_path)
    found = subprocess.run([sys.executable, "-P", "-c", CODE], cwd=tmp_path, capture_output=True, text=True, check=True)
    expected = numpy_runner.Agent(path)(tip_pose=np.eye(4))
    np.testing.assert_array_equal(np.array(found.stdout.split(), dtype=float), expected)


def test_it_remembers_until_it_is_reset(agent):
    path, measured = agent
    runner = numpy_runner.Agent(path)
    first, second = runner(**measured), runner(**measured)
    assert (runner.states["command"] == second).all() and not np.array_equal(first, second)
    runner.states["command"] = first  # what was really sent
    np.testing.assert_array_equal(runner(**measured), second)
    runner.reset()
    np.testing.assert_array_equal(runner(**measured), first)


@pytest.mark.cases(
    "given, error, message",
    [
        ({}, TypeError, "measurements should be tip_pose; they are none"),
        ({"tip_pose": np.eye(4), "strain": np.zeros(3)}, TypeError, "measurements should be tip_pose; they are tip_pose, strain"),
        ({"tip_pose": np.zeros(3)}, ValueError, r"tip_pose should have shape \(4, 4\), not \(3,\)"),
        ({"tip_pose": np.diag([1.0, 1.0, np.nan, 1.0])}, ValueError, "tip_pose should be finite, not nan"),
        ({"tip_pose": np.diag([1.0, 1.0, -1.0, 1.0])}, ValueError, "tip_pose should be homogeneous transforms: a rotation matrix"),
        ({"tip_pose": np.zeros((4, 4))}, ValueError, "tip_pose should be homogeneous transforms"),
    ],
)
def test_measurements_that_cannot_be(agent, given, error, message):
    path, _ = agent
    with pytest.raises(error, match=message):
        numpy_runner.Agent(path)(**given)


def test_files_that_are_none(agent, tmp_path):
    path, _ = agent
    content = path.read_bytes()
    for name, wrong in {"cut": content[: len(content) // 2], "text": b"an agent", "none": b""}.items():
        (tmp_path / name).write_bytes(wrong)
        with pytest.raises(ValueError, match=f"{name} is no exported agent, or was cut or damaged"):
            numpy_runner.Agent(tmp_path / name)
