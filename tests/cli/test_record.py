"""`soft-tendon record`: several policies, one file, the same episodes."""

import sys

SHORT = ("--seconds", "0.2", "--skip", "0.1")
QUICK = ("--scene", "three_tendon", "--fidelity", "fast")


def rows(printed):
    """Cells by the first of each row of a table, less its header."""
    lines = [[cell.strip() for cell in line.split("|")[1:-1]] for line in printed.splitlines() if line.startswith("| ")]
    return {cells[0]: cells[1:] for cells in lines[1:]}


def test_policies_are_arms_that_begin_every_episode_together(command, agent, recorded, tmp_path, capsys):
    file, out = agent(), tmp_path / "new" / "both.rrd"
    command("record", "feedforward", file, "--target", "circle", "--seeds", "3", "4", *SHORT, *QUICK, "--out", out)
    printed = capsys.readouterr().out
    found = rows(printed)
    assert list(found) == ["feedforward", str(file)] and found["feedforward"][0] != found[str(file)][0]
    assert [cells[-1] for cells in found.values()] == ["controller", "none"], "the model in the loop"
    assert "seeds 3, 4" in printed and f"`rerun {out}`" in printed
    assert recorded(out) == {"feedforward": list(range(22)), str(file): list(range(22))}, "two episodes of a reset and ten steps"


def test_scores_are_those_of_evaluate(command, recorded, tmp_path, capsys):
    command("record", "feedforward", *SHORT, *QUICK, "--out", tmp_path / "one.rrd")
    (alone,) = rows(capsys.readouterr().out).values()
    command("evaluate", "feedforward", "--errors", "nominal", "--episodes", "1", *SHORT, *QUICK, "--out", tmp_path)
    (evaluated,) = rows(capsys.readouterr().out).values()
    assert alone[:-2] == evaluated[:-2], "all but times"


def test_a_controller_acts_on_the_arm_of_the_agent_beside(command, agent, recorded, tmp_path, capsys):
    file = agent(control_period=0.04)
    command("record", "tracking", file, *SHORT, "--out", tmp_path / "borrowed.rrd")
    said = capsys.readouterr()
    arm = "scene = 'three_tendon', fidelity = 'fast', control_period = 0.04"
    assert f"note: TipPose: on the arm of the agents, {arm}" in said.err
    assert recorded(tmp_path / "borrowed.rrd") == {"tracking": list(range(6)), str(file): list(range(6))}
    command("record", "tracking", file, *SHORT, *QUICK, "--options", '{"control_period": 0.04}', "--out", tmp_path / "given.rrd")
    given = capsys.readouterr()
    assert "on the arm of" not in given.err and rows(given.out)["tracking"][:-2] == rows(said.out)["tracking"][:-2], "all but times"


def test_policies_of_different_episodes_are_not_put_side_by_side(refused, agent):
    one, other = agent(), agent(scene="paper")
    said = refused("record", one, other)
    assert f"{other} has scene = 'paper', {one} has 'three_tendon': their episodes would not be the same" in said


def test_without_rerun_the_remedy_is_named(refused, monkeypatch):
    monkeypatch.setitem(sys.modules, "rerun", None)
    assert 'pip install "soft_tendon_env[recording]"' in refused("record", "feedforward", *QUICK)
