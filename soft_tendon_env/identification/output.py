"""Files of an estimate: scene.toml, markers.toml, estimate.json, report.md, and measured.rrd where Rerun is installed."""

import importlib.util
from pathlib import Path
from typing import Any

import numpy as np
import tomli_w

from soft_tendon_env.evaluation.provenance import origin, write_json
from soft_tendon_env.identification.identify import Estimate
from soft_tendon_env.identification.parameters import DELAY, command_limits
from soft_tendon_env.identification.report import page
from soft_tendon_env.scene.scene import scene_to_dict
from soft_tendon_env.tools.configuration import plain
from soft_tendon_env.tools.files import digest, replacing


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
        from soft_tendon_env.identification.recording import write_recording

        files.append(folder / "measured.rrd")
        write_recording(found, files[-1])
    return files


def scene_text(found: Estimate) -> str:
    """The scene in TOML, with the origin of its numbers in a comment."""
    fitted, held_out = (f"{1e3 * error:.3g} mm" if np.isfinite(error) else "none" for error in found.errors)
    lines = [
        "# Identified by soft-tendon identify, 95 % intervals in brackets:",
        *(f"# {line}" for line in parameter_lines(found)),
        f"# Mean distance of the markers: {fitted} on {len(found.error_fit)} recordings of the fit, {held_out} on held-out ones.",
        *(f"# Data: {Path(file).name}, SHA-256 {digest(Path(file))}" for file in found.data),
        *(f"# {text}" for text in found.findings),
    ]
    return "\n".join([*lines, "", tomli_w.dumps(scene_to_dict(found.scene))])


def parameter_lines(found: Estimate) -> list[str]:
    """A line for each parameter: value, interval, whether the data contain it."""
    rows = zip(found.parameters, found.value, found.intervals.low, found.intervals.high, found.intervals.identified, strict=True)
    return [
        f"{own.name} = {value:.5g} [{low:.5g}, {high:.5g}]{'' if identified else ', not in the data'}"
        for own, value, low, high, identified in rows
    ]


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
