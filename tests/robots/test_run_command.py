"""`soft-tendon run`: a log and a report of a run; what stops it is said in one line."""

import re
import signal
import sys
from pathlib import Path

import pytest

from soft_tendon_env.cli.main import main
from soft_tendon_env.cli.run import load_robot
from soft_tendon_env.robots import SimulatedRobot

ARM = ["--scene", "three_tendon", "--fidelity", "fast"]
STEPPED = ["--robot-options", "real_time=false", "randomize={stiffness=0.8,latency=0.02}"]


class Deaf:
    """A robot that cannot be reached."""

    command_unit, senses = "N", ("tip_pose", "tip_twist", "tendon_length", "strain", "strain_rate")

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
    main(["run", "filtered:tracking", *ARM, *STEPPED, "--seconds", "1", "--skip", "0.4", "--settle", "0.2", "--out", str(out)])
    said = capsys.readouterr().out
    assert re.search(r"^position error: [\d.]+ mm \(root mean square", said, re.M) and re.search(r"^angle error: [\d.]+ deg", said, re.M)
    assert f"written: {out}\n" in said and "50 periods, 0 overruns" in said and "the run ended: tendons slack after" in said
    assert out.read_text().count("\n") - 2 == 50


def test_a_robot_that_does_not_answer_ends_it_in_one_line(tmp_path, capsys):
    out = tmp_path / "run.csv"
    with pytest.raises(SystemExit) as exit:
        main(["run", "filtered:tracking", *ARM, "--robot", f"{__name__}:Deaf", "--seconds", "1", "--out", str(out)])
    assert "the robot was stopped: reading failed: ConnectionError, the arm is deaf" in str(exit.value.code)
    said = capsys.readouterr().out
    assert "position error" not in said and f"written: {out}\n" not in said and not out.exists()  # there was none


def test_whoever_presses_ctrl_c_is_told_how_the_tendons_went(tmp_path, capsys):
    out, robot = tmp_path / "run.csv", ["--robot", f"{__name__}:Interrupted", "--robot-options"]
    options = ["scene=three_tendon", "fidelity=fast", "sensors=3", "real_time=false"]
    with pytest.raises(SystemExit) as exit:
        main(["run", "filtered:tracking", *ARM, *robot, *options, "--seconds", "9", "--out", str(out)])
    said = capsys.readouterr()
    assert exit.value.code == 130 and "\nstopped" in said.err and out.read_text().count("\n") > 20
    assert re.search(rf"written: {out}\ninterrupted: tendons slack after \d+ ms\n\n$", said.out)


def test_robots_of_this_folder_are_found(tmp_path, monkeypatch):
    monkeypatch.setattr(sys, "path", [*sys.path])
    monkeypatch.chdir(tmp_path)
    Path("my_arm_of_this_folder.py").write_text(f"from {__name__} import Deaf as Arm")
    assert isinstance(load_robot("my_arm_of_this_folder:Arm", {}), Deaf)


SIMULATED = "soft_tendon_env.robots:SimulatedRobot"


@pytest.mark.cases(
    "name, options, message",
    [
        ("no_module:Arm", {}, "robot is 'no_module:Arm' with the options {}: it should be MODULE:CLASS; No module named"),
        ("json:JSONDecoder", {}, "JSONDecoder should have read"),
        (SIMULATED, {"preview": [0.1]}, "preview is an unknown key: valid: control_period, fidelity"),
        (SIMULATED, {"model_error": "stiffness-20%"}, "model_error is an unknown key"),
    ],
)
def test_robots_that_there_are_not_are_refused(name, options, message):
    with pytest.raises((ValueError, TypeError)) as error:
        load_robot(name, options)
    assert message in str(error.value) and "\n" not in str(error.value)
