"""`soft-tendon record`: several policies, one file, the same episodes."""

import json
import subprocess
import sys
from pathlib import Path

import pytest

SCRIPT = Path(__file__).parent.parent.parent / "agents" / "record.py"
SHORT = ("--seconds", "0.2", "--skip", "0.1")
QUICK = ("--scene", "three_tendon", "--fidelity", "fast")


@pytest.fixture
def main(command):
    """main(arguments): `soft-tendon record` in this process."""
    return lambda *arguments: command("record", *arguments)


def rows(printed):
    """Cells by the first of each row of a table, less its header."""
    lines = [[cell.strip() for cell in line.split("|")[1:-1]] for line in printed.splitlines() if line.startswith("| ")]
    return {cells[0]: cells[1:] for cells in lines[1:]}


def test_policies_are_arms_that_begin_every_episode_together(main, agent, recorded, tmp_path, capsys):
    file, out = agent(), tmp_path / "new" / "both.rrd"
    main("feedforward", file, "--target", "circle", "--seeds", "3", "4", *SHORT, *QUICK, "--out", out)
    printed = capsys.readouterr().out
    found = rows(printed)
    assert list(found) == ["feedforward", str(file)] and found["feedforward"][0] != found[str(file)][0]
    assert "seeds 3, 4" in printed and f"`rerun {out}`" in printed
    assert recorded(out) == {"feedforward": list(range(22)), "best/model": list(range(22))}, "two episodes of a reset and ten steps"


def test_scores_are_those_of_evaluate(main, command, recorded, tmp_path, capsys):
    main("feedforward", *SHORT, *QUICK, "--out", tmp_path / "one.rrd")
    (alone,) = rows(capsys.readouterr().out).values()
    command("evaluate", "feedforward", "--errors", "nominal", "--episodes", "1", *SHORT, *QUICK, "--out", tmp_path)
    (evaluated,) = rows(capsys.readouterr().out).values()
    assert alone[:-2] == evaluated[:-2], "all but times"


def test_a_controller_acts_on_the_arm_of_the_agent_beside(main, agent, recorded, tmp_path, capsys):
    file = agent(control_period=0.04)
    main("tracking", file, *SHORT, "--out", tmp_path / "borrowed.rrd")
    said = capsys.readouterr()
    arm = "scene = 'three_tendon', fidelity = 'fast', control_period = 0.04"
    assert f"note: tracking: on the arm of the agents beside, {arm}" in said.err
    assert recorded(tmp_path / "borrowed.rrd") == {"tracking": list(range(6)), "best/model": list(range(6))}
    main("tracking", file, *SHORT, *QUICK, "--options", '{"control_period": 0.04}', "--out", tmp_path / "given.rrd")
    given = capsys.readouterr()
    assert "on the arm of" not in given.err and rows(given.out)["tracking"][:-2] == rows(said.out)["tracking"][:-2], "all but times"


def test_arms_of_agents_with_the_same_short_name_have_their_whole_names(main, agent, recorded, tmp_path):
    one, other = agent(), agent()
    main(one, other, *SHORT, "--out", tmp_path / "agents.rrd")
    assert set(recorded(tmp_path / "agents.rrd")) == {str(one), str(other)}


@pytest.mark.cases(
    "arguments, said",
    [
        (("trackin",), "did you mean 'tracking'?"),
        (("tracking", "--seeds", "-1"), "--seeds[0] is -1: it should be greater than or equal to 0"),
        (("tracking", "--seeds", "1.5"), "--seeds[0] is '1.5': it should be a valid integer"),
        (("tracking", "--target", "square"), "--target: type is 'square': valid: circle, hold, out_of_reach, ramp, random, steps"),
        (("{agent}", "{other}"), "{other} has scene = 'paper', {agent} has 'three_tendon': their episodes would not be the same"),
        (("tracking", "--out", "{folder}"), "{folder}"),
    ],
)
def test_mistakes_are_named_before_anything_runs(main, agent, tmp_path, capsys, arguments, said):
    known = {"agent": agent(), "other": agent(scene="paper"), "folder": tmp_path}
    with pytest.raises(SystemExit):
        main("--out", tmp_path / "none.rrd", *(argument.format(**known) for argument in arguments))
    assert said.format(**known) in capsys.readouterr().err
    assert not (tmp_path / "none.rrd").exists()


def test_without_rerun_the_remedy_is_named(tmp_path):
    given = ["record.py", "feedforward", *QUICK, "--out", str(tmp_path / "none.rrd")]
    code = f"import runpy, sys\nsys.modules['rerun'] = None\nsys.argv = {json.dumps(given)}\n"
    code += f"sys.path.insert(0, {str(SCRIPT.parent)!r})\nrunpy.run_path({str(SCRIPT)!r}, run_name='__main__')"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert done.returncode == 2 and 'pip install "soft_tendon_env[recording]"' in done.stderr and "Traceback" not in done.stderr
