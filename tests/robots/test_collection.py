"""Collection for identification: commands within the limits, motions that `identify` reads, slack
tendons at the end."""

import numpy as np
import pytest

from soft_tendon_env.cli.main import main
from soft_tendon_env.envs.episodes import episodes_of
from soft_tendon_env.identification.markers import load_markers
from soft_tendon_env.identification.recordings import read_recordings
from soft_tendon_env.robots import RobotEnv, RobotStopped
from soft_tendon_env.robots.collection import (
    HOLDS_TO_RELEASE,
    collect,
    collecting_env,
    drawn_commands,
    usual_hold,
)
from soft_tendon_env.robots.top_speed import half_swing
from soft_tendon_env.scene.file import load_scene

PERIOD = 0.02


@pytest.fixture
def env():
    made = collecting_env("three_tendon", "fast", PERIOD)
    yield made
    made.close()


def test_every_tendon_pulls_in_every_part_of_its_range_and_is_released(env):
    episodes = episodes_of(env)
    motions = drawn_commands(
        episodes, motions=3, holds=5, share=0.6, random=np.random.default_rng(0)
    )
    rest = episodes.start_command
    for commands in motions:
        is_release = (commands == rest).all(axis=1)
        between = np.diff(np.flatnonzero([True, *is_release]))
        assert is_release[-1]
        assert between.max() == HOLDS_TO_RELEASE + 1
        assert np.count_nonzero(~is_release) == 5
    commands = np.vstack(motions)
    pulls = commands[(commands != rest).any(axis=1)]
    most = 0.6 * load_scene("three_tendon").tendons[0].tension_limits[1]
    stratum = np.floor(15 * pulls / most)
    for column in stratum.T:
        assert sorted(column) == [*range(15)]


def test_pulls_are_shares_of_the_way_from_the_first_command_to_the_greatest():
    """Of tendons that are never slack: from 1 N, two fifths of the way to 5 N are 2.6 N."""
    scene = {"scene": "three_tendon"}
    for tendon in range(3):
        scene[f"tendons.{tendon}.tension_limits"] = [1.0, 5.0]
    env = collecting_env(scene, "fast", PERIOD)
    random = np.random.default_rng(0)
    (commands,) = drawn_commands(episodes_of(env), motions=1, holds=20, share=0.4, random=random)
    assert commands.min() == 1.0
    # the strongest pull of a tendon is in the last twentieth of the way
    strongest = commands.max(axis=0)
    assert (strongest <= 2.6).all()
    assert (strongest >= 1.0 + 0.95 * 1.6).all()
    env.close()


def test_a_hold_is_as_long_as_a_swing(env):
    episodes = episodes_of(env)
    assert usual_hold(episodes) == pytest.approx(2.0 * half_swing(episodes))


def test_every_motion_begins_at_rest_and_the_log_has_its_commands(env, arm_of_test, tmp_path):
    arm = arm_of_test()
    motions = [np.array([[2.0, 0.0, 1.0], [0.0, 0.0, 0.0]]), np.array([[0.0, 3.0, 0.0]])]
    log = tmp_path / "motions.csv"
    collect(RobotEnv(env, arm, log=log, settle=0.1), motions, hold=0.06)
    names = ("motions", "motions.1")
    columns = np.genfromtxt(log, delimiter=",", names=True, dtype=None, encoding="utf-8")
    sent = np.stack([columns[f"tension_{i}"] for i in range(3)], axis=1)
    for name, commands in zip(names, motions, strict=True):
        rows = columns["hold"] == name
        assert (sent[rows][0] == 0.0).all()
        expected_sent = np.repeat(commands, 3, axis=0)
        assert sent[rows][1:] == pytest.approx(expected_sent, abs=1e-6)
        assert np.diff(columns["time"][rows]) == pytest.approx(PERIOD)
    assert arm.is_slack
    assert arm.closed


def test_a_robot_that_is_lost_ends_the_collection_with_slack_tendons(env, arm_of_test, tmp_path):
    def is_lost(count):
        if count > 200:
            raise ConnectionError("the tracker is lost")

    arm = arm_of_test(read=is_lost)
    real = RobotEnv(env, arm, log=tmp_path / "motions.csv", settle=0.1)
    commands = np.full((1, 3), 2.0)
    with pytest.raises(RobotStopped, match="the tracker is lost"):
        collect(real, [commands], hold=9.0)
    assert arm.is_slack
    assert arm.closed


def test_identification_reads_what_the_command_leaves(tmp_path, capsys):
    out = tmp_path / "collected"
    short = ("--motions", "2", "--holds", "1", "--hold", "0.1", "--settle", "0.1")
    simulated = ("--robot-options", "real_time=false", "--fidelity", "fast")
    main(["collect", "three_tendon", *simulated, *short, "--out", str(out)])
    printed = capsys.readouterr().out
    assert "2 motions of 2 commands, 0.1 s each" in printed
    assert "tendons slack" in printed
    scene = load_scene("three_tendon")
    markers = load_markers(out / "markers.toml", scene)
    recordings = read_recordings([out / "motions.csv"], scene, markers)
    assert len(recordings) == 2
    for recording in recordings:
        assert recording.period == pytest.approx(PERIOD)
        assert recording.command.shape == (11, 3)
        assert (recording.command[0] == 0.0).all()
