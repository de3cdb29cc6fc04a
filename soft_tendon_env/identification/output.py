"""Files of an estimate: scene.toml, markers.toml, estimate.json, report.md, and measured.rrd where Rerun is installed."""

import importlib.util
from pathlib import Path
from typing import Any

import numpy as np
import tomli_w

from soft_tendon_env.evaluation.provenance import origin, write_json
from soft_tendon_env.evaluation.tables import markdown_table, number
from soft_tendon_env.identification.identify import Estimate
from soft_tendon_env.identification.parameters import DELAY, command_limits
from soft_tendon_env.identification.plant import base_rotation
from soft_tendon_env.identification.readings import Readings
from soft_tendon_env.recording.rollout import Rollout
from soft_tendon_env.scene.scene import scene_to_dict
from soft_tendon_env.tools.configuration import plain
from soft_tendon_env.tools.files import digest, replacing
from soft_tendon_env.tools.types import Array

HOLD = 1.0
"""How long [s] a hold is shown in a recording."""


def save_estimate(found: Estimate, folder: Path) -> list[Path]:
    """Writes an estimate into a folder; returns the files. Without Rerun there is no recording. Raises OSError."""
    folder.mkdir(parents=True, exist_ok=True)
    texts = {"scene.toml": scene_text(found), "markers.toml": tomli_w.dumps(plain(found.markers)), "report.md": page(found)}
    for name, text in texts.items():
        with replacing(folder / name) as temporary:
            temporary.write_text(text, encoding="utf-8")
    write_json(folder / "estimate.json", as_json(found), say=False)
    files = [folder / name for name in (*texts, "estimate.json")]
    if importlib.util.find_spec("rerun") is not None:
        files.append(folder / "measured.rrd")
        _write_recording(found, files[-1])
    return files


def summary(found: Estimate) -> str:
    """Tables of errors and parameters, and the findings."""
    counts = zip(("fit", "held out"), (found.error_fit.size, found.error_held_out.size), found.before, found.errors, strict=True)
    errors = [(name, str(count), number(1e3 * before), number(1e3 * after)) for name, count, before, after in counts]
    spread = found.intervals
    pairs = zip(found.parameters, found.value, spread.low, spread.high, spread.identified, strict=True)
    rows = [
        (own.name, f"{own.value:.4g}", f"{value:.4g}", f"{low:.4g} to {high:.4g}", "yes" if seen else "no")
        for own, value, low, high, seen in pairs
    ]
    tables = [
        markdown_table(("markers' mean distance", "recordings", "before [mm]", "identified [mm]"), errors),
        markdown_table(("parameter", "before", "identified", "95 % interval", "in the data"), rows),
    ]
    return "\n\n".join([*tables, *(["\n".join(f"- {text}" for text in found.findings)] if found.findings else [])])


def page(found: Estimate) -> str:
    """The summary, and the error of each recording."""
    rows = []
    for readings, errors, kind in ((found.fitted, found.error_fit, "fit"), (found.held_out, found.error_held_out, "held out")):
        for own, error in zip(readings.recordings, errors, strict=True):
            rows.append((own.name, kind, ", ".join(f"{value:.3g}" for value in np.abs(own.command).max(axis=0)), number(1e3 * error)))
    table = markdown_table(("recording", "used for", f"commands [{found.scene.effects.command_unit}]", "error [mm]"), rows)
    return f"# {found.scene.name}: identified from {len(found.error_fit)} recordings\n\n{summary(found)}\n\n{table}\n"


def scene_text(found: Estimate) -> str:
    """The scene in TOML, beneath a comment with the report: the origin of its numbers, their intervals and the findings."""
    comment = "".join(f"# {line}".rstrip() + "\n" for line in summary(found).splitlines())
    return f"# Identified by soft-tendon identify:\n{comment}\n{tomli_w.dumps(scene_to_dict(found.scene))}"


def as_json(found: Estimate) -> dict[str, Any]:
    """Estimate as plain JSON: parameters, errors, correlations, findings, randomisation, versions, digests of the data."""
    spread, (fitted, held_out) = found.intervals, found.errors
    parameters = {
        own.name: {
            "value": found.value[i],
            "low": spread.low[i],
            "high": spread.high[i],
            "linear": spread.linear[i],
            "bootstrap": spread.bootstrap[i],
            "before": own.value,
            "prior": own.prior,
            "identified": bool(spread.identified[i]),
        }
        for i, own in enumerate(found.parameters)
    }
    return plain(
        {
            "parameters": parameters,
            "error_mm": {
                "fit": 1e3 * fitted,
                "held_out": 1e3 * held_out,
                "before": {"fit": 1e3 * found.before[0], "held_out": 1e3 * found.before[1]},
            },
            "noise_mm": 1e3 * found.fit.sigma,
            "correlation": spread.correlation,
            "findings": list(found.findings),
            "measurement": found.measurement._asdict(),
            "randomize": randomize(found),
            "held_out": [own.name for own in found.held_out.recordings],
            "data": {Path(file).name: digest(Path(file)) for file in found.data},
            **origin(),
        }
    )


def randomize(found: Estimate) -> dict[str, Any]:
    """Table `randomize` of an environment with the identified scene: what the intervals leave open.

    Parameters that neither the data nor a prior contain are left out. Latency comes on top of the delay that the scene has. Offsets are
    tensions [N], of which an environment takes the share of the range of displacements where an arm is driven by these.
    """
    table = dict[str, Any]()
    gains, offsets = list[float](), list[float]()
    spread, tension = found.intervals, np.array([tendon.tension_limits for tendon in found.scene.tendons])
    unit = np.ptp(tension, axis=1) / np.ptp(command_limits(found.scene), axis=1)  # [N] of an offset by 1
    for own, value, low, high, seen in zip(found.parameters, found.value, spread.low, spread.high, spread.identified, strict=True):
        if not seen and own.prior is None:
            continue
        if own.of_scene is not None:
            table[own.name] = {"factor": [low, high]} if own.of_scene.is_factor else [low, high]
        elif own.name == DELAY:
            table["latency"] = [0.0, high - value]
        elif own.name.endswith(".gain"):
            gains.extend((low, high))
        elif own.name.startswith("commands."):
            offsets.extend(unit[int(own.name.split(".")[1])] * np.array([low, high]))
    table |= {"tension_gain": [min(gains), max(gains)]} if gains else {}
    return dict[str, Any](plain(table | ({"tension_offset": [min(offsets), max(offsets)]} if offsets else {})))


def _write_recording(found: Estimate, path: Path) -> None:
    """Writes measured markers over the identified arm: holds one after another, then every motion. Raises OSError."""
    from soft_tendon_env.recording.rerun_file import RerunFile  # here: Rerun is an extra

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
