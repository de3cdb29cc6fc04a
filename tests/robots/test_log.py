"""Logs are read as they were written, by whoever reads columns; none is overwritten or lost; a replayed run is the run again."""

import gymnasium as gym
import numpy as np
import pytest

from soft_tendon_env.identification import Marker, MarkerSet
from soft_tendon_env.identification.recordings import read_recordings
from soft_tendon_env.policies import load_policy, policy_options
from soft_tendon_env.robots import ReplayRobot, RobotEnv, RobotStopped, SimulatedRobot, rehearse, run_policy
from soft_tendon_env.scene.file import load_scene
from soft_tendon_env.scene.scene import rod_length

SMALL = {"scene": "three_tendon", "fidelity": "fast"}
NOISE = {"position": 1e-3, "rotation": 0.01, "length": 1e-4, "curvature": 0.05, "stretch": 1e-3}
LENGTHS = (6, 1, 9)


def test_a_replayed_run_is_the_run_again_and_identification_reads_its_log(tmp_path, columns_of_log):
    options, path = policy_options("filtered:tracking", "TipPose", SMALL), tmp_path / "first.csv"

    def run(robot, seconds, **more):
        env = gym.make("TendonRod-TipPose-v0", **options, randomize={"noise": NOISE})
        policy = load_policy("filtered:tracking", env)
        rehearse(policy, env)
        return run_policy(policy, RobotEnv(env, robot, **more), seconds, seed=4)

    robot = SimulatedRobot(**SMALL, sensors=options["sensors"], randomize={"noise": NOISE}, real_time=False)
    report = run(robot, 0.5, log=path, settle=0.2)
    log = columns_of_log(path)
    assert report.finished and log.keys() >= {"tip_x", "tip_qw", "tip_wx", "tendon_length_2", "strain_2_shear_z", "strain_rate_0_torsion"}
    again = run(ReplayRobot(path), 0.48)  # the last measurement has no period
    for name, errors in again.errors.items():
        np.testing.assert_allclose(errors, report.errors[name][:25], atol=1e-9)
    scene = load_scene("three_tendon")
    (motion,) = read_recordings([path], scene, MarkerSet(markers={"tip": Marker(arc_length=rod_length(scene), orientation=True)}))
    assert motion.name == "first" and motion.period == pytest.approx(0.02)
    assert (motion.command[1:, 0] == log["tension_0"]).all() and (motion.positions[1:, 0, 0] == log["tip_x"]).all()


@pytest.fixture
def episodes(tmp_path):
    """The log of episodes of LENGTHS, an environment for them, their actions and what was observed."""
    path, random = tmp_path / "new" / "run.csv", np.random.default_rng(0)

    def made(robot, **options):
        return RobotEnv(gym.make("TendonRod-Reach-v0", **SMALL, observation=["tip_position", "tendon_lengths"]), robot, **options)

    env = made(SimulatedRobot(**SMALL, real_time=False, randomize={"noise": NOISE}), log=path)
    actions = [random.uniform(-1.0, 0.5, (length, 3)) for length in LENGTHS]
    seen = [[env.reset(seed=0)[0], *(env.step(action)[0] for action in one)] for one in actions]
    env.reset(seed=0)  # which is no episode yet
    env.close()
    return path, made, actions, [[one["observation"] for one in episode] for episode in seen]


def test_a_replay_has_the_episodes_of_its_log(episodes):
    path, made, actions, seen = episodes
    env = made(ReplayRobot(path))
    for each, expected in zip(actions, seen, strict=True):
        found = [env.reset(seed=0)[0], *(env.step(action)[0] for action in each[:-1])]
        np.testing.assert_allclose([one["observation"] for one in found], expected[:-1], atol=1e-7)
        *_, truncated, info = env.step(each[-1])  # the last measurement has no period
        assert truncated and "no further row" in info["stopped"]
    with pytest.raises(RobotStopped, match=r"the log .*run.csv has no further row of this episode"):
        env.reset(seed=0)
    env.close()


def test_rows_at_rest_are_measurements_of_their_own_and_cut_ones_are_left_out(episodes):
    path, text = episodes[0], episodes[0].read_text()
    header, *rows = (line.split(",") for line in text.splitlines())
    first = [dict(zip(header, row, strict=True)) for row in rows[:2]]
    times, measured_times, tips = ([float(row[name]) for row in first] for name in ("time", "measured_time", "tip_x"))
    assert times == [-0.02, 0.0] and np.diff(measured_times) == pytest.approx(0.02)
    assert 1e-6 < abs(tips[1] - tips[0]) < 0.01  # the noise differs
    path.write_text(text[:-2])
    tip = MarkerSet(markers={"tip": Marker(arc_length=0.3)})
    with pytest.warns(UserWarning, match=f"line {len(rows) + 1} was cut off"):
        found = read_recordings([path], load_scene("three_tendon"), tip)
    assert [len(one.command) for one in found] == [7, 2, 9]


@pytest.mark.cases("text", ["a,b\n1,2\n", "time,tension_0\n1,2\n", "time,measured_time,tension_0,commanded_0\n"])
def test_what_is_no_log_is_refused(text, tmp_path):
    path = tmp_path / "x.csv"
    path.write_text(text)
    with pytest.raises(ValueError, match="is no log of a run"):
        ReplayRobot(path)


def test_no_log_is_overwritten(arm_of_test, drawing, tmp_path):
    path = tmp_path / "run.csv"
    env = RobotEnv(drawing(), arm_of_test(), log=path)
    env.reset(seed=0)
    env.close()
    assert not path.exists()  # a run without a row may be tried again
    env = RobotEnv(drawing(), arm_of_test(), log=path)
    env.reset(seed=0)
    env.step(np.zeros(3))
    assert len(path.read_text().splitlines()) == 3, "rows are there before the next period"
    env.close()
    text = path.read_text()
    path.with_name("run_2.csv").touch()
    with pytest.raises(FileExistsError, match=r"no log is overwritten: give another name, such as .*/run_3\.csv"):
        RobotEnv(drawing(), arm_of_test(), log=path)
    with pytest.raises(ValueError, match=r"it should be a file \*.csv"):
        RobotEnv(drawing(), arm_of_test(), log=tmp_path / "run.txt")
    assert path.read_text() == text


def test_a_full_disk_stops_the_run_and_keeps_the_rows(arm_of_test, drawing, pulling, tmp_path, monkeypatch):
    arm, path = arm_of_test(), tmp_path / "run.csv"
    env = RobotEnv(drawing(), arm, log=path)
    write = env._log._writer.writerows

    class Full:
        def writerows(self, rows):
            if env.timing.periods > 10:
                raise OSError(28, "No space left on device")
            write(rows)

    monkeypatch.setattr(env._log, "_writer", Full())
    report = run_policy(pulling(), env, 1.0, report=tmp_path / "run.json")
    assert report.stop.cause == f"the log {path} cannot be written: No space left on device" and report.stop.slack and arm.is_slack
    assert (tmp_path / "run.json").exists() and len(path.read_text().splitlines()) >= 10
