"""Logs are read as they were written, by whoever reads columns of CSV or Parquet; a replayed run is the run again."""

import gymnasium as gym
import numpy as np
import pytest

from soft_tendon_env.identification import Marker, MarkerSet, identify
from soft_tendon_env.identification.recordings import read_recordings
from soft_tendon_env.policies import load_policy, policy_options
from soft_tendon_env.robots import ReplayRobot, RobotEnv, SimulatedRobot, read_log, rehearse, run_policy
from soft_tendon_env.scene.file import load_scene
from soft_tendon_env.scene.scene import rod_length
from soft_tendon_env.tools.tables import rows_of

SMALL = {"scene": "three_tendon", "fidelity": "fast"}
NOISE = {"position": 1e-3, "rotation": 0.01, "length": 1e-4, "curvature": 0.05, "stretch": 1e-3}


@pytest.fixture
def ran(tmp_path):
    """ran(suffix): the log of a short run of a filtered controller on a simulated robot, and a maker of its environment and policy."""
    options = policy_options("filtered:tracking", "TipPose", SMALL)

    def made():
        env = gym.make("TendonRod-TipPose-v0", **options, randomize={"noise": NOISE})
        policy = load_policy("filtered:tracking", env)
        rehearse(policy, env)
        return env, policy

    def run(suffix):
        if suffix == ".parquet":
            pytest.importorskip("pyarrow")
        env, policy = made()
        robot = SimulatedRobot(**SMALL, sensors=options["sensors"], randomize={"noise": NOISE}, real_time=False)
        report = run_policy(policy, RobotEnv(env, robot, log=tmp_path / f"first{suffix}", settle=0.2), 0.5, seed=4)
        assert report.finished
        return tmp_path / f"first{suffix}", report

    return run, made


@pytest.mark.parametrize("suffix", [".csv", ".parquet"])
def test_a_replayed_run_is_the_run_again(suffix, ran, tmp_path):
    run, made = ran
    path, report = run(suffix)
    first = read_log(path)
    assert first.sent.shape == (25, 3) and first.senses == ("tip_pose", "tip_twist", "tendon_length", "strain", "strain_rate")
    robot = ReplayRobot(path)
    env, policy = made()
    again = run_policy(policy, RobotEnv(env, robot, settle=0.0), 0.48, seed=4)  # the last measurement has no period
    np.testing.assert_allclose(robot.deviation, np.zeros((24, 3)), atol=1e-6)
    for name, errors in again.errors.items():
        np.testing.assert_allclose(errors, report.errors[name][:25], atol=1e-9)


@pytest.mark.parametrize("suffix", [".csv", ".parquet"])
def test_identification_reads_a_log_as_it_is(suffix, ran):
    path, _ = ran[0](suffix)
    (_, header), *lines = rows_of(path)
    rows = [dict(zip(header, cells, strict=True)) for _, cells in lines]
    numbers = [f"{name}_{i}" for name in ("tension", "commanded", "tendon_length") for i in range(3)]
    assert rows[0].keys() >= {"hold", "time", "tip_x", "tip_y", "tip_z", "tip_qw", "strain_2_shear_z", *numbers}
    assert {row["hold"] for row in rows} == {"first"}
    scene = load_scene("three_tendon")
    (motion,) = read_recordings([path], scene, MarkerSet(markers={"tip": Marker(arc_length=rod_length(scene))}))
    log = read_log(path)
    assert motion.period == pytest.approx(0.02) and (motion.command[1:] == log.sent).all()
    np.testing.assert_allclose(motion.positions[1:, 0], [own.tip_pose[:3, 3] for own in log.measured], atol=1e-12)


def test_a_log_begins_with_the_command_that_held_the_arm_at_rest(tmp_path):
    robot = SimulatedRobot(**SMALL, real_time=False)
    env = RobotEnv(gym.make("TendonRod-Reach-v0", **SMALL, observation=["tip_position"]), robot, log=tmp_path / "steps.csv", settle=30.0)
    random = np.random.default_rng(0)
    for _ in range(2):
        env.reset(seed=0)
        for action in np.repeat(random.uniform(-1.0, 1.0, (2, 3)), 5, axis=0):
            env.step(action)
    env.reset(seed=0)  # which is no motion yet
    env.close()
    scene = load_scene("three_tendon")
    markers, parameters = MarkerSet(markers={"tip": Marker(arc_length=rod_length(scene))}), ["segments.*.young_modulus"]
    found = identify(scene, tmp_path / "steps.csv", markers, parameters, fidelity="fast", held_out=0)
    assert len(found.error_fit) == 2 and found.before[0] < 1e-4 < np.ptp(found.fitted.measured[:, 0, 1])
    assert found.value[0] == pytest.approx(scene.segments[0].young_modulus, rel=1e-3)


def test_what_is_no_log_is_refused(tmp_path, arm_of_test, drawing):
    path = tmp_path / "x.csv"
    for text, message in [
        ("a,b\n1,2\n", "it has no column tension_0 or displacement_0"),
        ("time,tension_0\n1,2\n", "it has no column measured_time, commanded_0"),
        ("time,measured_time,tension_0,commanded_0\n", "has no rows beneath the first line"),
        ("time,measured_time,tension_0,commanded_0\n0,0,1\n", "line 2 should be 4 cells"),
        ("time,measured_time,tension_0,commanded_0,commanded_1\n0,0,1,1,1\n", "it has no column tension_1"),
    ]:
        path.write_text(text)
        with pytest.raises(ValueError, match=message):
            ReplayRobot(path)
    with pytest.raises(ValueError, match=r"it should be a file \*.csv or \*.parquet"):
        RobotEnv(drawing(), arm_of_test(), log=tmp_path / "run.txt")
