"""Conversion of agents saved by Stable-Baselines3 (model.zip, vecnormalize.pkl) to the form that loads without unpickling.

    python -m soft_tendon_env.policies.convert FOLDER ...

The statistics are unpickled, which runs what is in the file: convert only agents of your own. Of model.zip the weights alone are read.
"""

import json
import pickle
import sys
from pathlib import Path

from soft_tendon_env.policies.agent import was_normalised
from soft_tendon_env.policies.agent_files import CONFIG, PICKLED, AgentFiles, read_config
from soft_tendon_env.policies.network import WEIGHTS, algorithm_in, architecture_in, read_zip
from soft_tendon_env.policies.normalization import STATISTICS, normalization_of, save_normalization
from soft_tendon_env.tools.files import check_digests, digest, open_file, read_json


def convert_agent(folder: Path) -> None:
    """Write weights.pt and statistics.npz into an agent's folder, and what they need into its config.json.

    The files that they come from stay. Raises ValueError, OSError, among others where they are not those that config.json names.
    """
    import torch

    zipped = folder / "model.zip"
    config = read_config(AgentFiles(zipped))
    check_digests(folder, {name: config.files[name] for name in (zipped.name, PICKLED) if name in config.files}, folder / CONFIG)
    settings, weights = read_zip(zipped)
    algorithm = config.algorithm or algorithm_in(settings)
    if algorithm is None:
        raise ValueError(f"{zipped} does not say which algorithm it is of: write algorithm into {folder / CONFIG}")
    torch.save(weights, folder / WEIGHTS)
    written = [WEIGHTS]
    table = read_json(folder / CONFIG) if (folder / CONFIG).exists() else {}
    if (folder / PICKLED).exists():
        with open_file(folder / PICKLED) as file:
            normalization = normalization_of(pickle.load(file))
        if normalization is not None:
            save_normalization(folder / STATISTICS, normalization)
            written.append(STATISTICS)
        table["normalise"] = {**config.normalise, "observations": normalization is not None}
    elif "observations" not in config.normalise:
        table["normalise"] = {**config.normalise, "observations": was_normalised(settings)}
    policy = architecture_in(settings, algorithm, zipped).policy
    table.setdefault("algorithm", algorithm)
    table.setdefault("hyperparameters", {"policy_kwargs": policy})
    table["files"] = {**table.get("files", {}), **{name: digest(folder / name) for name in written}}
    (folder / CONFIG).write_text(json.dumps(table, indent=1) + "\n")


if __name__ == "__main__":
    for argument in sys.argv[1:]:
        convert_agent(Path(argument))
        print(f"converted: {argument}")
