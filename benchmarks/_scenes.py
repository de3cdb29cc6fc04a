"""Arms that the benchmarks measure: scenes that ship with passive fields, a new one too. The
paper's comes first."""

from soft_tendon_env.scene.file import SHIPPED, scene_names
from soft_tendon_env.scene.passive_fields import SUFFIX


def names(ending: str) -> tuple[str, ...]:
    """Scenes that ship with a file of passive fields of this ending."""
    found = [name for name in scene_names() if (SHIPPED / f"{name}{ending}").exists()]
    return tuple(sorted(found, key=lambda name: (name != "paper", name)))


WITH_FIELDS = names(SUFFIX)
SOFT_ARMS = tuple(name for name in names(f"_loaded{SUFFIX}") if name != "catheter")
"""Those with fields for no load and for loads, but the stiff wire, which tests/hard_cases
measures."""
