"""Scene files in TOML: load by the name of a shipped scene or by path, save."""

import os
from pathlib import Path

import tomli_w

from soft_tendon_env.scene.scene import Scene, scene_to_dict
from soft_tendon_env.tools.checks import checked_type
from soft_tendon_env.tools.configuration import ConfigurationError, Problem, not_among, read_toml
from soft_tendon_env.tools.files import replacing

SHIPPED = Path(__file__).parent / "library"


def scene_names() -> tuple[str, ...]:
    """Returns the names of the scenes that ship.

    Returns:
        Names, sorted.
    """
    return tuple(sorted(path.stem for path in SHIPPED.glob("*.toml")))


def load_scene(name_or_path: str | os.PathLike[str]) -> Scene:
    """Loads the scene of an arm from a TOML file.

    Args:
        name_or_path: name of a shipped scene, or the path of a file in ".toml".

    Returns:
        The scene.

    Raises:
        TypeError: for what is neither a text nor a path.
        ConfigurationError: with a line per mistake, in the file or in the name.
    """
    if not isinstance(name_or_path, str | os.PathLike):
        raise TypeError(
            "name_or_path should be the name of a shipped scene or the path of a TOML file, not"
            f" {type(name_or_path).__name__}"
        )
    name = os.fspath(name_or_path)
    path = Path(name_or_path)
    if path.suffix != ".toml":
        if name not in scene_names():
            text = (
                "is neither the path of a .toml file nor a scene that ships:"
                f" {not_among(name, scene_names())}"
            )
            raise ConfigurationError([Problem((), text)], repr(name))
        path = SHIPPED / f"{name}.toml"
    values = read_toml(path)
    strain = values.get("strain")
    # wrong types are for the check
    passive = None
    if isinstance(strain, dict):
        passive = strain.get("passive")
    if isinstance(passive, dict):
        file = passive.get("file")
        if isinstance(file, str):
            # a file of fields is written relative to the scene's own
            passive["file"] = str((path.parent / file).absolute())
    return Scene.parse(values, str(path))


def save_scene(scene: Scene, path: str | os.PathLike[str]) -> None:
    """Saves a scene as TOML that loads back equal.

    The file appears whole or not at all.

    Args:
        scene: to save.
        path: of the file.

    Raises:
        TypeError: for what is no scene.
        OSError: where the file cannot be written.
    """
    checked_type("scene", scene, Scene, "see load_scene")
    table = scene_to_dict(scene)
    text = tomli_w.dumps(table)
    with replacing(Path(path)) as temporary:
        temporary.write_text(text, encoding="utf-8")
