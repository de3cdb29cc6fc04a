"""Seeds of `reset`, a range for each purpose. No two ranges share a seed, which is asserted: policies are not judged on what chose them."""

SEEDS = {
    "tuning": range(100, 112),
    "evaluation": range(1_000_000, 1_000_020),
    "arena": range(2_000_000, 2_001_000),
    "validation": range(3_000_000, 3_000_100),
    "training": range(2**32, 2**32 + 2**48),
}
"""Ranges by purpose: parameters of controllers are tuned on "tuning"; `evaluate`, `compare` and `demo` judge on "evaluation", `arena` on
"arena"; learning curves are measured, and the best agent of a training chosen, on "validation"; arms that agents train on draw theirs from
"training"."""

_ordered = sorted(SEEDS.values(), key=lambda seeds: seeds.start)
assert all(one.stop <= other.start for one, other in zip(_ordered, _ordered[1:], strict=False)), "every seed has one purpose"

EVALUATION_SEEDS = tuple(SEEDS["evaluation"])
"""Fixed list of episodes on which agents and controllers are compared."""
VALIDATION_SEEDS = tuple(SEEDS["validation"])
"""Fixed list of episodes of learning curves, on which the best agent of a training is chosen."""
