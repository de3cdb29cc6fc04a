"""Options of commands about one arm: its scene, changes of it, and the file with what is made for it."""

from collections.abc import Callable
from pathlib import Path
from typing import TypeVar

from soft_tendon_env.scene.artifacts.learned_strain import LearnedStrain
from soft_tendon_env.scene.artifacts.passive_fields import PassiveFields
from soft_tendon_env.scene.file import load_scene
from soft_tendon_env.scene.scene import Scene
from soft_tendon_env.tools.configuration import Configuration, ConfigurationError, parsed_changes


class ArmSettings(Configuration):
    """The arm that a command is about.

    Attributes:
        scene: a shipped scene's name, or the path of a TOML file.
        set: changes of the scene, dotted keys with values as in TOML, such as effects.gravity.acceleration=[0,0,-9.81].
    """

    scene: str
    set: tuple[str, ...] = ()

    def changed_scene(self) -> Scene:
        """The scene with the changes of --set. Raises ConfigurationError, ValueError."""
        scene = load_scene(self.scene)
        try:
            return scene.replace(parsed_changes(self.set)) if self.set else scene
        except ConfigurationError as error:
            raise ConfigurationError(error.problems, "--set") from error


Made = TypeVar("Made", PassiveFields, LearnedStrain)


class FileSettings(ArmSettings):
    """The file of what a command makes for an arm.

    Attributes:
        out: the file to write, beside the scene say; by default in the user's cache, where every scene with this arm finds it.
        anew: make it again where there is one for this arm, these limits and loads.
    """

    out: str | None = None
    anew: bool = False

    def file(self, usual: Path, suffix: str) -> Path:
        """Path of --out, or the usual one. Raises ValueError where its ending is another than that of `suffix`."""
        ending = Path(suffix).suffix
        if self.out is not None and not self.out.endswith(ending):
            raise ValueError(f"--out is {self.out}: it should be the path of a {ending} file, such as {Path(self.scene).stem}{suffix}")
        return usual if self.out is None else Path(self.out)

    def present(self, scene: Scene, read: Callable[[Path], Made], find: Callable[[Scene], Made | None]) -> Made | None:
        """Fields or strain made for this very arm, its limits and loads, in the file of --out or anywhere; None if there are none."""
        if self.anew:
            return None
        found = find(scene) if self.out is None else read(Path(self.out)) if Path(self.out).exists() else None
        return found if found is not None and found.fits(scene) and not found.misfit(scene) else None

    def entry(self) -> str:
        """End of a scene's entry, which names the file of --out if there is one."""
        return "" if self.out is None else f', file = "{Path(self.out).name}"'


def written(made: Made, path: Path) -> Made:
    """Save what was made, and say where."""
    made.save(path)
    print(f"written: {path}\n")
    return made
