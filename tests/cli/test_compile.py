"""`soft-tendon compile` uses every scene in every way, and says where machine code is kept."""

import pytest

from soft_tendon_env.cli import compile as compiling
from soft_tendon_env.compiler.compilation import cache_folder


def test_every_stage_of_every_scene_is_done_once_and_the_bar_ends(command, capsys, monkeypatch):
    done = []
    monkeypatch.setattr(compiling, "use", lambda scene, stage: done.append((scene.name, stage)))
    command("compile", "--scenes", "paper", "three_tendon")
    printed = capsys.readouterr()
    assert done == [(name, stage) for name in ("paper", "three_tendon") for stage in compiling.STAGES]
    assert "12/12" in printed.err and f"kept in {cache_folder()}" in printed.out


@pytest.mark.parametrize("stage", compiling.STAGES)
def test_a_stage_works(stage):
    compiling.use(compiling.load_scene("three_tendon"), stage)
