"""`soft-tendon run`: a log and a report of a run, what stops it is said in one line; logs are read
as written, none is lost."""

import re
import signal
import sys
from pathlib import Path

import gymnasium as gym
import numpy as np
import pytest

from soft_tendon_env.cli.main import main
from soft_tendon_env.cli.robot_settings import load_robot
from soft_tendon_env.identification import Marker, MarkerSet
from soft_tendon_env.identification.recordings import read_recordings
from soft_tendon_env.policies import load_policy, policy_options
from soft_tendon_env.robots import RobotEnv, SimulatedRobot, rehearse, run_policy
from soft_tendon_env.robots.clock import Clock
from soft_tendon_env.scene.file import load_scene

ARM = ["--scene", "three_tendon", "--fidelity", "fast"]
STEPPED = ["--robot-options", "real_time=false", "randomize={stiffness=0.8,latency=0.02}"]
SIMULATED = "soft_tendon_env.robots:SimulatedRobot"
SMALL = {"scene": "three_tendon", "fidelity": "fast"}
NOISE = {"position": 1e-3, "rotation": 0.01, "length": 1e-4, "curvature": 0.05, "stretch": 1e-3}
TIP = MarkerSet(markers={"tip": Marker(arc_length=0.3)})


class Deaf:
    """A robot that cannot be reached, in stepped time."""

    command_unit = "N"
    senses = ("tip_pose", "tip_twist", "tendon_length", "strain", "strain_rate")

    def __init__(self):
        self.clock = Clock(real=False)

    def read(self):
        raise ConnectionError("the arm is deaf")

    def write(self, command):
        return command

    def close(self):
        pass


class Interrupted(SimulatedRobot):
    """A simulated arm at whose 200th reading somebody presses Ctrl-C."""

    count = 0

    def read(self):
        self.count += 1
        if self.count == 200:
            signal.raise_signal(signal.SIGINT)
        return super().read()


def test_a_run_leaves_a_log_and_prints_its_errors(tmp_path, capsys):
    out = tmp_path / "a" / "run.csv"
    main(
        [
            "run",
            "filtered:tracking",
            *ARM,
            *STEPPED,
            "--seconds",
            "1",
            "--skip",
            "0.4",
            "--settle",
            "0.2",
            "--out",
            str(out),
        ]
    )
    said = capsys.readouterr().out
    assert re.search(r"^position error: [\d.]+ mm \(root mean square", said, re.M)
    assert re.search(r"^angle error: [\d.]+ deg", said, re.M)
    assert f"written: {out}\n" in said
    assert "50 periods, 0 overruns" in said
    assert "the run ended: tendons slack after" in said
    assert out.read_text().count("\n") - 2 == 50


def test_a_robot_that_does_not_answer_ends_it_in_one_line(tmp_path, capsys):
    out = tmp_path / "run.csv"
    with pytest.raises(SystemExit) as exit:
        main(
            [
                "run",
                "filtered:tracking",
                *ARM,
                "--robot",
                f"{__name__}:Deaf",
                "--seconds",
                "1",
                "--out",
                str(out),
            ]
        )
    assert "the robot was stopped: reading failed: ConnectionError, the arm is deaf" in str(
        exit.value.code
    )
    said = capsys.readouterr().out
    assert "position error" not in said
    assert f"written: {out}\n" not in said
    assert not out.exists()


def test_whoever_presses_ctrl_c_is_told_how_the_tendons_went(tmp_path, capsys):
    out = tmp_path / "run.csv"
    robot = ["--robot", f"{__name__}:Interrupted", "--robot-options"]
    options = ["scene=three_tendon", "fidelity=fast", "sensors=3", "real_time=false"]
    with pytest.raises(SystemExit) as exit:
        main(
            [
                "run",
                "filtered:tracking",
                *ARM,
                *robot,
                *options,
                "--seconds",
                "9",
                "--out",
                str(out),
            ]
        )
    said = capsys.readouterr()
    assert exit.value.code == 130
    assert "\nstopped" in said.err
    assert out.read_text().count("\n") > 20
    assert re.search(
        rf"written: {out}\ninterrupted by SIGINT: tendons slack after \d+ ms\n\n$", said.out
    )


def test_robots_of_this_folder_are_found(tmp_path, monkeypatch):
    monkeypatch.setattr(sys, "path", [*sys.path])
    monkeypatch.chdir(tmp_path)
    Path("my_arm_of_this_folder.py").write_text(f"from {__name__} import Deaf as Arm")
    assert isinstance(load_robot("my_arm_of_this_folder:Arm", {}), Deaf)


@pytest.mark.parametrize(
    ("name", "options", "message"),
    [
        (
            "no_module:Arm",
            {},
            (
                "robot is 'no_module:Arm' with the options {}: it should be MODULE:CLASS; No module"
                " named"
            ),
        ),
        ("json:JSONDecoder", {}, "JSONDecoder should have read"),
        (
            SIMULATED,
            {"preview": [0.1]},
            "preview is an unknown key: valid: control_period, fidelity",
        ),
        (SIMULATED, {"model_error": "stiffness-20%"}, "model_error is an unknown key"),
    ],
)
def test_robots_that_there_are_not_are_refused(name, options, message):
    with pytest.raises((ValueError, TypeError)) as error:
        load_robot(name, options)
    assert message in str(error.value)
    assert "\n" not in str(error.value)


def test_identification_reads_the_log_of_a_run(tmp_path, columns_of_log):
    options = policy_options("filtered:tracking", "TipPose", SMALL)
    path = tmp_path / "first.csv"
    env = gym.make("TendonRod-TipPose-v0", **options, randomize={"noise": NOISE})
    policy = load_policy("filtered:tracking", env)
    rehearse(policy, env)
    robot = SimulatedRobot(
        **SMALL, sensors=options["sensors"], randomize={"noise": NOISE}, real_time=False
    )
    report = run_policy(policy, RobotEnv(env, robot, log=path, settle=0.2), 0.5, seed=4)
    log = columns_of_log(path)
    names = {
        "tip_x",
        "tip_qw",
        "tip_wx",
        "tendon_length_2",
        "strain_2_shear_z",
        "strain_rate_0_torsion",
    }
    assert report.finished
    assert {*log.dtype.names} >= names
    scene = load_scene("three_tendon")
    (motion,) = read_recordings([path], scene, TIP)
    assert motion.name == "first"
    assert motion.period == pytest.approx(0.02)
    assert (motion.command[1:, 0] == log["tension_0"]).all()
    assert (motion.positions[1:, 0, 0] == log["tip_x"]).all()


def test_episodes_begin_with_a_row_at_rest_and_rows_that_were_cut_off_are_left_out(tmp_path):
    path = tmp_path / "new" / "run.csv"
    random = np.random.default_rng(0)
    env = gym.make("TendonRod-Reach-v0", **SMALL, observation=["tip_position", "tendon_lengths"])
    env = RobotEnv(
        env, SimulatedRobot(**SMALL, real_time=False, randomize={"noise": NOISE}), log=path
    )
    for length in (6, 1, 9):
        env.reset(seed=0)
        for action in random.uniform(-1.0, 0.5, (length, 3)):
            env.step(action)
    env.reset(seed=0)  # which is no episode yet
    env.close()
    text = path.read_text()
    header, *rows = (line.split(",") for line in text.splitlines())
    first = [dict(zip(header, row, strict=True)) for row in rows[:2]]
    times, measured_times, tips = (
        [float(row[name]) for row in first] for name in ("time", "measured_time", "tip_x")
    )
    assert times == [-0.02, 0.0]
    assert np.diff(measured_times) == pytest.approx(0.02)
    assert 1e-6 < abs(tips[1] - tips[0]) < 0.01  # the noise differs
    path.write_text(text[:-2])
    with pytest.warns(UserWarning, match=f"line {len(rows) + 1} was cut off"):
        found = read_recordings([path], load_scene("three_tendon"), TIP)
    assert [len(one.command) for one in found] == [7, 2, 9]


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
    with pytest.raises(
        FileExistsError, match=r"no log is overwritten: give another name, such as .*/run_3\.csv"
    ):
        RobotEnv(drawing(), arm_of_test(), log=path)
    with pytest.raises(ValueError, match=r"it should be a file \*.csv"):
        RobotEnv(drawing(), arm_of_test(), log=tmp_path / "run.txt")
    assert path.read_text() == text


def test_a_full_disk_stops_the_run_and_keeps_the_rows(
    arm_of_test, drawing, pulling, tmp_path, monkeypatch
):
    arm = arm_of_test()
    path = tmp_path / "run.csv"
    env = RobotEnv(drawing(), arm, log=path)
    write = env._log._writer.writerows

    class Full:
        def writerows(self, rows):
            if env.unwrapped.episodes.arms.pacer.count > 10:
                raise OSError(28, "No space left on device")
            write(rows)

    monkeypatch.setattr(env._log, "_writer", Full())
    report = run_policy(pulling(), env, 1.0)
    assert report.stop.cause == f"the log {path} cannot be written: No space left on device"
    assert report.stop.slack
    assert arm.is_slack
    assert len(path.read_text().splitlines()) >= 10
