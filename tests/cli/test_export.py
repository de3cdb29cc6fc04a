"""The command that writes an agent as an ONNX file: what it leaves and what it says, for an agent that was just trained."""

import re

import pytest

pytest.importorskip("onnx")
pytest.importorskip("onnxruntime")


def test_a_trained_agent(command, finished, capsys, tmp_path):
    command("export", finished / "best", "--out", tmp_path / "made" / "arm.onnx")
    said = capsys.readouterr().out
    assert [path.name for path in (tmp_path / "made").iterdir()] == ["arm.onnx"]
    assert "| tip_pose " in said and "| coordinates " in said and "the command [N] of 3 tendons, 50 times a second" in said
    assert re.search(r"^\| onnxruntime +\|", said, re.MULTILINE) and re.search(r"^\| original +\|", said, re.MULTILINE)


def test_a_file_that_acts_otherwise_is_told(command, finished, capsys, monkeypatch, tmp_path):
    from soft_tendon_env.export import check

    monkeypatch.setattr(check, "ALLOWED", -1.0)
    with pytest.raises(SystemExit, match="arm.onnx: commands differ from the original's by more than -1 of their range"):
        command("export", finished / "best", "--out", tmp_path / "arm.onnx")
