"""Writes the golden numbers of the code that is imported, to golden.npz beside this file, and where
they are from to golden.json.

    python tests/golden/make.py

Run it where numbers are meant to change, or, to compare with another commit on the same machine,
with that commit's checkout on PYTHONPATH.
"""

import json
from pathlib import Path

import golden_numbers
import numpy as np

from soft_tendon_env.evaluation.provenance import origin

if __name__ == "__main__":
    here = Path(__file__).parent
    arrays = {
        f"{part}/{name}": array
        for part, numbers in golden_numbers.PARTS.items()
        for name, array in numbers().items()
    }
    np.savez_compressed(here / "golden.npz", **arrays)
    (here / "golden.json").write_text(json.dumps(origin(), indent=1) + "\n")
