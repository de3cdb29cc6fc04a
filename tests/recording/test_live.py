"""`render_mode="human"`: what would go to the viewer goes to a file here, and is read back."""

import socket
import sys

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.error import Error

from soft_tendon_env.registration import IDS

rr = pytest.importorskip("rerun")
from rerun.chunk import RrdReader  # noqa: E402

from soft_tendon_env.recording import live  # noqa: E402

SMALL = {"scene": "three_tendon", "fidelity": "fast"}


@pytest.fixture
def sent(tmp_path, monkeypatch):
    """sent(): for every viewer that was connected, {entity: rows of numbers}, once its environment
    is closed."""
    files = []

    def save(recording, url):
        file = tmp_path / f"{len(files)}.rrd"
        files.append(file)
        recording.save(files[-1])

    monkeypatch.setattr(live, "is_open", lambda port: True)
    monkeypatch.setattr(rr.RecordingStream, "connect_grpc", save)

    def read(path):
        rows = {}
        for chunk in RrdReader(path).stream():
            batch = chunk.to_record_batch()
            if "Scalars:scalars" in batch.schema.names:
                rows.setdefault(chunk.entity_path, []).extend(batch["Scalars:scalars"].to_pylist())
        return rows

    return lambda: [read(path) for path in files]


@pytest.fixture
def port():
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return probe.getsockname()[1]


def test_an_episode_is_streamed_as_it_happens(sent):
    env = gym.make(IDS["TipPose"], render_mode="human", **SMALL)
    assert not isinstance(env, gym.wrappers.HumanRendering), "which needs pygame"
    tensions = []
    errors = []
    for seed in (0, 1):
        _, info = env.reset(seed=seed)
        for step in range(6):
            tension = env.unwrapped.episodes.tension[0].copy()
            tensions.append(tension)
            errors.append(info["position_error"])
            if step < 5:
                *_, info = env.step(np.full(3, 0.1 * step, dtype=np.float32))
                assert env.render() is None
    env.close()
    env.close()
    (rows,) = sent()
    np.testing.assert_array_equal(rows["/tension/arm"], tensions)
    np.testing.assert_array_equal(np.array(rows["/error/arm/position_error"])[:, 0], errors)


def test_without_a_display_the_error_says_so(port, monkeypatch):
    monkeypatch.setattr(sys, "platform", "linux")
    monkeypatch.setattr(live, "PORT", port)
    for name in live.DISPLAYS:
        monkeypatch.delenv(name, raising=False)
    with pytest.raises(
        Error, match='needs a display, and none of DISPLAY, .* is set: use render_mode="rgb_array"'
    ) as raised:
        gym.make(IDS["TipPose"], render_mode="human", **SMALL)
    assert "\n" not in str(raised.value)
