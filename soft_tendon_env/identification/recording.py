"""Rerun recording of measured markers over the identified arm: holds one after another, then every motion."""

from pathlib import Path

import numpy as np

from soft_tendon_env.identification.identify import Estimate
from soft_tendon_env.identification.plant import base_rotation
from soft_tendon_env.identification.readings import Readings
from soft_tendon_env.recording.rerun_file import RerunFile
from soft_tendon_env.recording.rollout import Rollout
from soft_tendon_env.tools.types import Array

HOLD = 1.0
"""How long [s] a hold is shown."""


def write_recording(found: Estimate, path: Path) -> None:
    """Writes the recording. Raises OSError."""
    with RerunFile(path, trail=0.0) as file:
        for readings, title in ((found.fitted, "fit"), (found.held_out, "held out")):
            for rollout in _rollouts(found, readings, title) if readings.recordings else ():
                file.write(rollout)


def _rollouts(found: Estimate, readings: Readings, title: str) -> list[Rollout]:
    """Holds as one episode, and every motion as one."""
    plant = readings.plants.at(found.fit.x)
    coordinates = readings.coordinates(plant)
    inside = (readings.measured - found.measurement.shift) @ base_rotation(found.measurement.rotation)
    holds = sum(not own.period for own in readings.recordings)
    ends = np.cumsum([len(own.command) for own in readings.recordings])
    parts = [(slice(0, holds), HOLD, f"{title}: {holds} holds")] if holds else []
    for own, end in zip(readings.recordings[holds:], ends[holds:], strict=True):
        parts.append((slice(int(end) - len(own.command), int(end)), own.period, f"{title}: {own.name}"))
    command = plant.command(np.concatenate([own.command for own in readings.recordings]))

    def rollout(samples: slice, period: float, name: str) -> Rollout:
        q: list[Array] = coordinates[samples]
        strain = np.array([plant.model.strain(own)[1] for own in q])
        tip = np.array([plant.model.tip_pose(own) for own in q])
        return Rollout(plant.model, period, strain, command[samples], tip, markers=inside[samples], title=name)

    return [rollout(*part) for part in parts]
