"""`soft-tendon collect`: motions of a robot under drawn commands, as `soft-tendon identify` reads
them."""

from pathlib import Path

import numpy as np
import tomli_w
from pydantic import Field

from soft_tendon_env.cli.errors import mistakes, writable_folder
from soft_tendon_env.cli.options import ArmSettings
from soft_tendon_env.cli.robot_settings import RobotSettings
from soft_tendon_env.envs.episodes import episodes_of
from soft_tendon_env.evaluation.settings import Seed
from soft_tendon_env.identification.markers import Marker, MarkerSet
from soft_tendon_env.robots.collection import collect, collecting_env, drawn_commands, usual_hold
from soft_tendon_env.robots.log import check_log
from soft_tendon_env.tools.configuration import plain
from soft_tendon_env.tools.types import Positive

SHARE = 0.6
"""Share of the range of commands that is used: an arm may be twice as soft as its drawing."""


class Collect(RobotSettings, ArmSettings):
    """Collect motions of a robot for identification: holds and releases of drawn commands within
    the limits, from rest."""

    motions: int = Field(default=4, ge=1, description="number of motions, each from rest")
    holds: int = Field(default=6, ge=1, description="drawn commands in a motion")
    hold: Positive | None = Field(
        default=None, description="time [s] of each; by default one swing of the arm as drawn"
    )
    share: float = Field(
        default=SHARE, gt=0.0, le=1.0, description="of the range of commands that is used"
    )
    control_period: Positive = Field(default=0.02, description="time [s] between rows of the log")
    fidelity: str = Field(
        default="standard", description="of the model that says how long a swing of the arm is"
    )
    seed: Seed = Field(default=0, description="of the commands")
    out: str = Field(
        default="out/collected", description="folder for motions.csv, a new file, and markers.toml"
    )


def run(settings: Collect) -> None:
    """Collect, print and write."""
    with mistakes():
        scene = settings.changed_scene()
        out = writable_folder(Path(settings.out))
        log = out / "motions.csv"
        check_log(log)
        env = collecting_env(scene, settings.fidelity, settings.control_period)
        episodes = episodes_of(env)
        random = np.random.default_rng(settings.seed)
        motions = drawn_commands(episodes, settings.motions, settings.holds, settings.share, random)
        hold = settings.hold
        if hold is None:
            hold = usual_hold(episodes)
        of_arm = {"scene": scene, "fidelity": settings.fidelity}
        real = settings.opened(env, log, of_arm)
    length = episodes.model.length
    commands = len(motions[0])
    print(f"{settings.motions} motions of {commands} commands, {hold:.3g} s each")
    try:
        collect(real, motions, hold)
    finally:  # also after Ctrl-C
        stop = real.stopped
        if stop:
            tendons = "slack" if stop.slack else f"not slack: {stop.failures[-1]}"
            print(f"{stop.cause}: tendons {tendons}")
    markers = MarkerSet(markers={"tip": Marker(arc_length=length)})
    markers_file = out / "markers.toml"
    markers_file.write_text(tomli_w.dumps(plain(markers)), encoding="utf-8")
    print(f"written: {log}")
    print(f"written: {markers_file}")
