"""Files of an estimate: scene.toml, markers.toml and estimate.json."""

from pathlib import Path
from typing import Any

import numpy as np
import tomli_w

from soft_tendon_env.evaluation.provenance import origin, write_json
from soft_tendon_env.evaluation.tables import markdown_table, number
from soft_tendon_env.identification.identify import Estimate
from soft_tendon_env.identification.parameters import DELAY, command_limits
from soft_tendon_env.scene.scene import scene_to_dict
from soft_tendon_env.tools.configuration import plain
from soft_tendon_env.tools.files import digest, replacing


def save_estimate(found: Estimate, folder: Path) -> list[Path]:
    """Writes an estimate into a folder; returns the files. Raises OSError."""
    folder.mkdir(parents=True, exist_ok=True)
    comment = "".join(f"# {line}".rstrip() + "\n" for line in summary(found).splitlines())
    scene = f"# Identified by soft-tendon identify:\n{comment}\n{tomli_w.dumps(scene_to_dict(found.scene))}"
    files = {folder / "scene.toml": scene, folder / "markers.toml": tomli_w.dumps(plain(found.markers))}
    for path, text in files.items():
        with replacing(path) as temporary:
            temporary.write_text(text, encoding="utf-8")
    write_json(folder / "estimate.json", _as_json(found), say=False)
    return [*files, folder / "estimate.json"]


def summary(found: Estimate) -> str:
    """Tables of errors and parameters, and the findings."""
    counts = zip(("fit", "held out"), (found.error_fit, found.error_held_out), found.before, found.errors, strict=True)
    errors = [(name, str(len(each)), number(1e3 * before), number(1e3 * after)) for name, each, before, after in counts]
    spread = found.intervals
    rows = [
        (one.name, f"{one.value:.4g}", f"{value:.4g}", f"{low:.4g} to {high:.4g}", "yes" if seen else "no")
        for one, value, low, high, seen in zip(found.parameters, found.value, *spread[:3], strict=True)
    ]
    tables = [
        markdown_table(("markers' mean distance", "recordings", "before [mm]", "identified [mm]"), errors),
        markdown_table(("parameter", "before", "identified", "95 % interval", "in the data"), rows),
    ]
    return "\n\n".join([*tables, *(["\n".join(f"- {text}" for text in found.findings)] if found.findings else [])])


def _as_json(found: Estimate) -> dict[str, Any]:
    """Estimate as plain JSON: parameters, errors, findings, randomisation, versions, digests of the data."""
    rows = zip(found.parameters, found.value, *found.intervals[:3], strict=True)
    parameters = {
        one.name: {"value": value, "low": low, "high": high, "before": one.value, "prior": one.prior, "identified": bool(seen)}
        for one, value, low, high, seen in rows
    }
    errors = {
        name: {"mean": 1e3 * mean, "each": {one: 1e3 * error for one, error in each.items()}}
        for name, each, mean in zip(("fit", "held_out"), (found.error_fit, found.error_held_out), found.errors, strict=True)
    }
    told = {"noise_mm": 1e3 * found.noise, "findings": found.findings, "measurement": found.measurement._asdict()}
    data = {Path(file).name: digest(Path(file)) for file in found.data}
    return plain({"parameters": parameters, "error_mm": errors, **told, "randomize": randomize(found), "data": data, **origin()})


def randomize(found: Estimate) -> dict[str, Any]:
    """Table `randomize` of an environment with the identified scene: what the intervals leave open.

    Parameters that neither the data nor a prior contain are left out. Latency comes on top of the delay that the scene has. Offsets are
    tensions [N], of which an environment takes the share of the range of displacements where an arm is driven by these.
    """
    table, gains, offsets = dict[str, Any](), list[float](), list[float]()
    tension = np.array([tendon.tension_limits for tendon in found.scene.tendons])
    unit = np.ptp(tension, axis=1) / np.ptp(command_limits(found.scene), axis=1)  # [N] of an offset by 1
    for one, value, low, high, seen in zip(found.parameters, found.value, *found.intervals[:3], strict=True):
        if not seen and one.prior is None:
            continue
        if one.of_scene is not None:
            table[one.name] = {"factor": [low, high]} if one.of_scene.is_factor else [low, high]
        elif one.name == DELAY:
            table["latency"] = [0.0, high - value]
        elif one.name.endswith(".gain"):
            gains += low, high
        elif one.name.startswith("commands."):
            offsets += (unit[int(one.name.split(".")[1])] * np.array([low, high])).tolist()
    ranges = {name: [min(ends), max(ends)] for name, ends in (("tension_gain", gains), ("tension_offset", offsets)) if ends}
    return dict[str, Any](plain(table | ranges))
