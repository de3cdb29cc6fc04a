"""Logs are read as they were written, by whoever reads columns; none is overwritten or lost; a replayed run is the run again."""

import warnings

import gymnasium as gym
import numpy as np
import pytest

from soft_tendon_env.identification import Marker, MarkerSet, identify
from soft_tendon_env.identification.recordings import read_recordings
from soft_tendon_env.policies import load_policy, policy_options
from soft_tendon_env.robots import ReplayRobot, RobotEnv, RobotStopped, SimulatedRobot, read_log, rehearse, run_policy
from soft_tendon_env.scene.file import load_scene
from soft_tendon_env.scene.scene import rod_length
from soft_tendon_env.tools.tables import read_table

SMALL = {"scene": "three_tendon", "fidelity": "fast"}
NOISE = {"position": 1e-3, "rotation": 0.01, "length": 1e-4, "curvature": 0.05, "stretch": 1e-3}


@pytest.fixture
def ran(tmp_path):
    """The log and report of a short run of a filtered controller on a simulated robot, and a maker of its environment and policy."""
    options = policy_options("filtered:tracking", "TipPose", SMALL)

    def made():
        env = gym.make("TendonRod-TipPose-v0", **options, randomize={"noise": NOISE})
        policy = load_policy("filtered:tracking", env)
        rehearse(policy, env)
        return env, policy

    env, policy = made()
    robot = SimulatedRobot(**SMALL, sensors=options["sensors"], randomize={"noise": NOISE}, real_time=False)
    report = run_policy(policy, RobotEnv(env, robot, log=tmp_path / "first.csv", settle=0.2), 0.5, seed=4)
    assert report.finished
    return tmp_path / "first.csv", report, made


def test_a_replayed_run_is_the_run_again(ran):
    path, report, made = ran
    first = read_log(path)
    assert first.sent.shape == (25, 3) and first.senses == ("tip_pose", "tip_twist", "tendon_length", "strain", "strain_rate")
    robot = ReplayRobot(path)
    env, policy = made()
    again = run_policy(policy, RobotEnv(env, robot), 0.48, seed=4)  # the last measurement has no period
    np.testing.assert_allclose(robot.deviation, np.zeros((24, 3)), atol=1e-6)
    for name, errors in again.errors.items():
        np.testing.assert_allclose(errors, report.errors[name][:25], atol=1e-9)


def test_identification_reads_a_log_as_it_is(ran):
    path, *_ = ran
    _, header, lines, _ = read_table(path)
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
    env = RobotEnv(gym.make("TendonRod-Reach-v0", **SMALL, observation=["tip_position"]), robot, log=tmp_path / "steps.csv")
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
        ("time,measured_time,tension_0,commanded_0\n0,0,1\n", "line 2: there are 3 cells, the header has 4"),
        ("time,measured_time,tension_0,commanded_0,commanded_1\n0,0,1,1,1\n", "it has no column tension_1"),
    ]:
        path.write_text(text)
        with pytest.raises(ValueError, match=message):
            ReplayRobot(path)
    for name in ("run.txt", "run.parquet", "run.csv.gz", "run"):
        with pytest.raises(ValueError, match=r"it should be a file \*.csv"):
            RobotEnv(drawing(), arm_of_test(), log=tmp_path / name)


LENGTHS = (6, 1, 9)


@pytest.fixture
def episodes(tmp_path):
    """The log of episodes of LENGTHS, an environment for them, their actions and what was observed."""
    path, random = tmp_path / "new" / "run.csv", np.random.default_rng(0)

    def made(robot, **options):
        return RobotEnv(gym.make("TendonRod-Reach-v0", **SMALL, observation=["tip_position", "tendon_lengths"]), robot, **options)

    env = made(SimulatedRobot(**SMALL, real_time=False, randomize={"noise": NOISE}), log=path)
    actions = [random.uniform(-1.0, 0.5, (length, 3)) for length in LENGTHS]
    seen = [[env.reset(seed=0)[0], *(env.step(action)[0] for action in own)] for own in actions]
    env.reset(seed=0)  # which is no episode yet
    env.close()
    return path, made, actions, [[own["observation"] for own in episode] for episode in seen]


def test_a_replay_has_the_episodes_of_its_log(episodes):
    path, made, actions, seen = episodes
    log = read_log(path)
    assert np.bincount(log.episode).tolist() == [*LENGTHS] and (log.time[np.flatnonzero(np.diff(log.episode)) + 1] == 0.0).all()
    robot = ReplayRobot(path)
    env = made(robot)
    for i, (own, expected) in enumerate(zip(actions, seen, strict=True)):
        found = [env.reset(seed=0)[0], *(env.step(action)[0] for action in own[:-1])]
        np.testing.assert_allclose([one["observation"] for one in found], expected[:-1], atol=1e-7)
        *_, truncated, info = env.step(own[-1])  # the last measurement has no period
        assert truncated and f"episode {i} of the log ends after {LENGTHS[i]} periods" in info["stopped"]
    assert robot.deviation.shape == (sum(LENGTHS) - 3, 3) and np.abs(robot.deviation).max() < 1e-6
    with pytest.raises(RobotStopped, match="the log has no further episode"):
        env.reset(seed=0)
    env.close()
    env = made(ReplayRobot(path))  # an episode that is left early is not gone on with
    env.reset(seed=0)
    env.step(actions[0][0])
    np.testing.assert_allclose(env.reset(seed=0)[0]["observation"], seen[1][0], atol=1e-7)
    env.close()


def test_rows_at_rest_are_measurements_of_their_own(episodes):
    _, header, rows, _ = read_table(episodes[0])
    first = [dict(zip(header, cells, strict=True)) for _, cells in rows[:2]]
    times, measured_times, tips = ([float(row[name]) for row in first] for name in ("time", "measured_time", "tip_x"))
    assert times == [-0.02, 0.0] and np.diff(measured_times) == pytest.approx(0.02)
    assert 1e-6 < abs(tips[1] - tips[0]) < 0.01  # the noise differs


def test_a_log_is_read_up_to_its_last_whole_row(episodes, tmp_path, recwarn):
    """Wherever it is cut, also within the last number, where the cells are all there, and behind the row at rest."""
    text = episodes[0].read_bytes()
    markers, scene = MarkerSet(markers={"tip": Marker(arc_length=0.3)}), load_scene("three_tendon")
    path, lines = tmp_path / "cut.csv", text.splitlines(keepends=True)
    ends = np.cumsum([len(line) for line in lines])
    at_rest = [i for i, line in enumerate(lines) if b",-0.02," in line]
    for place in (len(text) - 1, len(text) - 2, len(text) - 40, ends[5] + 1, ends[at_rest[1]] + 9, ends[at_rest[2]], ends[at_rest[2]] + 30):
        for left in (b"", bytes(512)):  # blocks that never came to the disk
            path.write_bytes(text[:place] + left)
            whole, is_cut = text[:place].count(b"\n") - 1, not text[:place].endswith(b"\n")
            recwarn.clear()
            warnings.simplefilter("always")
            log = read_log(path)
            assert len(log.time) == whole - sum(place >= ends[i] for i in at_rest)
            assert [f"cut.csv, line {whole + 2} was cut off" in str(own.message) for own in recwarn] == [True] * is_cut
            assert sum(len(own.command) for own in read_recordings([path], scene, markers)) == whole


def test_tables_without_a_last_newline_keep_whole_rows(tmp_path, recwarn):
    path = tmp_path / "foreign.csv"
    path.write_text("hold,tension_0,tip_x\na,1,0.1\nb,2,0.2")
    assert [cells for _, cells in read_table(path).rows] == [["a", "1", "0.1"], ["b", "2", "0.2"]] and not recwarn.list
    path.write_text("hold;tension_0;tip_x\na;1;0.1\nb;2")
    assert len(read_table(path).rows) == 1 and "foreign.csv, line 3 was cut off" in str(recwarn.pop().message)


def test_no_log_is_overwritten(arm_of_test, drawing, tmp_path):
    path = tmp_path / "run.csv"
    env = RobotEnv(drawing(), arm_of_test(), log=path)
    with pytest.raises(FileExistsError, match="run.csv is there already, and no log is overwritten: give another name"):
        RobotEnv(drawing(), arm_of_test(), log=path)  # at the same time
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
    assert path.read_text() == text


class Pulling:
    def predict(self, observation, state=None, episode_start=None, deterministic=True):
        return np.array([0.5, -0.5, 0.0]), None


def test_a_full_disk_stops_the_run_and_keeps_the_rows(arm_of_test, drawing, tmp_path, monkeypatch):
    arm, path = arm_of_test(), tmp_path / "run.csv"
    env = RobotEnv(drawing(), arm, log=path)
    flush = env._log._file.flush

    def full():
        if len(path.read_text().splitlines()) > 10:
            raise OSError(28, "No space left on device")
        flush()

    monkeypatch.setattr(env._log, "_file", Proxy(env._log._file, full))
    report = run_policy(Pulling(), env, 1.0, report=tmp_path / "run.json")
    assert report.stop.cause == f"the log {path} cannot be written: No space left on device" and report.stop.slack and arm.is_slack
    assert (tmp_path / "run.json").exists() and len(read_log(path).time) >= 9


class Proxy:
    """A file with another flush, as on a full disk also when it is closed."""

    def __init__(self, file, flush):
        self.file, self.flush = file, flush

    def __getattr__(self, name):
        return getattr(self.file, name)

    def close(self):
        self.file.close()
        self.flush()
