"""`soft-tendon scenes`: the scenes that ship as a table, or one of them as TOML."""

from pathlib import Path

from pydantic import Field
from tyro.conf import Positional

from soft_tendon_env.cli.errors import mistakes
from soft_tendon_env.evaluation.tables import markdown_table
from soft_tendon_env.model.coordinates import coordinate_count
from soft_tendon_env.scene.file import SHIPPED, load_scene, scene_names
from soft_tendon_env.tools.configuration import Configuration
from soft_tendon_env.tools.files import read_text

NAME = "a scene that ships, or the path of a TOML file; by default a table of those that ship"


class Scenes(Configuration):
    """List the scenes that ship, with tendons and coordinates; of one, print the TOML, which is a
    commented example of the format."""

    name: Positional[str | None] = Field(default=None, description=NAME)


def run(settings: Scenes) -> None:
    """Print the table, or the file."""
    if settings.name is None:
        shipped = map(load_scene, scene_names())
        rows = [
            (scene.name, str(len(scene.tendons)), str(coordinate_count(scene)), scene.description)
            for scene in shipped
        ]
        print(markdown_table(("scene", "tendons", "coordinates", "what it is"), rows))
        return
    with mistakes():
        load_scene(settings.name)  # whose error says what is wrong with the file
        path = SHIPPED / f"{settings.name}.toml"
        if settings.name.endswith(".toml"):
            path = Path(settings.name)
        print(read_text(path), end="")
