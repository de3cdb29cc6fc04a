"""Sweeps with Ray Tune: the same runs, as trials."""

import time

import pytest

from soft_tendon_env.learning.sweep import Job, Sweep
from soft_tendon_env.tools.configuration import ConfigurationError

CONFIG = """
task = "TipPose"
algorithm = "PPO"
steps = 256
arms = 4
seconds = 0.4
hyperparameters = { n_steps = 16, batch_size = 32, n_epochs = 1 }
options = { scene = "three_tendon", fidelity = "fast" }
evaluation = { every = 128, episodes = 2, skip = 0.2 }
"""


@pytest.fixture
def config(tmp_path):
    path = tmp_path / "small.toml"
    path.write_text(CONFIG)
    return path


def test_a_sweep_has_trials_where_ray_is_installed(monkeypatch, config):
    for there in (True, False):
        monkeypatch.setattr("soft_tendon_env.learning.sweep.find_spec", lambda name, there=there: object() if there else None)
        assert Sweep(configs=(str(config),)).with_ray == there
        assert not Sweep(configs=(str(config),), scheduler="processes").with_ray
        assert Sweep(configs=(str(config),), scheduler="tune").with_ray
        assert Sweep(configs=(str(config),), address="auto").with_ray
    with pytest.raises(ConfigurationError, match="address is for --scheduler tune"):
        Sweep(configs=(str(config),), scheduler="processes", address="auto")
    with pytest.raises(ConfigurationError, match="runners is for --engine rllib"):
        Sweep(configs=(str(config),), runners=2)


def test_every_run_has_the_engine_of_the_sweep(tmp_path, config):
    (job,) = Sweep(configs=(str(config),), seeds=1, engine="rllib", runners=4).jobs(tmp_path)
    assert " --engine rllib --runners 4" in " ".join(job.command) and job.processors == 5
    (job,) = Sweep(configs=(str(config),), seeds=1).jobs(tmp_path)
    assert "--engine" not in job.command and job.processors == 1
    with pytest.raises(ConfigurationError, match="arms is 4: it should be a multiple of the 3 runners"):
        Sweep(configs=(str(config),), engine="rllib", runners=3).tasks()


def test_runs_are_trials_and_one_that_fails_stops_no_other(tmp_path, config, monkeypatch):
    pytest.importorskip("ray")
    from soft_tendon_env.learning.tune import FOLDER, tune_all

    monkeypatch.chdir(tmp_path)
    out = tmp_path / "runs"
    good = [Job(config.relative_to(tmp_path), seed, out.relative_to(tmp_path) / f"seed_{seed}", ()) for seed in (0, 1)]
    bad = Job(config, 2, out / "seed_2", ("options.fidelity=quick",))
    started = time.time()
    assert tune_all([good[0], bad, good[1]], 2, out, None) == [bad]
    assert "options.fidelity is 'quick'" in bad.log.read_text()
    for job in good:
        assert (job.folder / "evaluations.csv").stat().st_mtime > started and (job.folder / "best" / "weights.pt").is_file()
    curves = [path.read_text() for path in (out / FOLDER).glob("*/*/progress.csv") if path.stat().st_size]
    assert len(curves) == 2 and all("position_error_rms" in curve and len(curve.splitlines()) == 4 for curve in curves), "Tune knows them"
