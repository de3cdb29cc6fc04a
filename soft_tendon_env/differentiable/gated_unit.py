"""Minimal gated unit in PyTorch, and features of small entries: parts of policy networks.

Trainings and exports of agents share them; `policies.layers` has the same in NumPy.
"""

from collections.abc import Callable

import torch
from torch import Tensor

Layer = Callable[[Tensor], Tensor]


def next_memory(gate: Layer, candidate: Layer, values: Tensor, memory: Tensor) -> Tensor:
    """Next memory (rows, size) of a minimal gated unit.

    G.-B. Zhou et al., Int. J. Automation and Computing 13, 2016.

    Args:
        gate: layer from (rows, n + size) to (rows, size), before its sigmoid.
        candidate: layer likewise, before its hyperbolic tangent.
        values: observed (rows, n).
        memory: of the control period before (rows, size).
    """
    before = torch.cat([values, memory], dim=1)
    share = torch.sigmoid(gate(before))
    parts = [values, share * memory]
    recalled = torch.cat(parts, dim=1)
    new = torch.tanh(candidate(recalled))
    return memory + share * (new - memory)


def with_fine_entries(values: Tensor, factor: float) -> Tensor:
    """Entries (rows, 2 n) x and tanh(factor x) of values x (rows, n), x alone for a factor of 0.

    A network sees small entries, as errors of a millimetre are, in the second half.
    """
    if not factor:
        return values
    fine = torch.tanh(factor * values)
    return torch.cat([values, fine], dim=1)
