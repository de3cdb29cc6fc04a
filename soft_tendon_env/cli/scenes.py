"""`soft-tendon scenes`: the scenes that ship as a table, or one of them as TOML."""

from pathlib import Path

from pydantic import Field

from soft_tendon_env.cli.errors import mistakes
from soft_tendon_env.evaluation.tables import markdown_table
from soft_tendon_env.model.coordinates import make_strain
from soft_tendon_env.model.grid import at_points, make_grid
from soft_tendon_env.scene.file import SHIPPED, load_scene, scene_names
from soft_tendon_env.scene.scene import Scene
from soft_tendon_env.tools.configuration import Configuration
from soft_tendon_env.tools.files import read_text

INTERVALS = 6  # of a piece of the rod: how many coordinates there are does not depend on them
NAME = "a scene that ships, or the path of a TOML file; by default a table of those that ship"


class Scenes(Configuration):
    """List the scenes that ship, with tendons and coordinates; of one, print the TOML, which is a commented example of the format."""

    name: str | None = Field(default=None, description=NAME, json_schema_extra={"flag": "name"})


def run(settings: Scenes) -> None:
    """Print the table, or the file."""
    if settings.name is None:
        scenes = [load_scene(shipped) for shipped in scene_names()]
        rows = [(scene.name, str(len(scene.tendons)), str(coordinate_count(scene)), scene.description) for scene in scenes]
        print(markdown_table(("scene", "tendons", "coordinates", "what it is"), rows))
        return
    with mistakes():
        load_scene(settings.name)
        print(read_text(Path(settings.name) if settings.name.endswith(".toml") else SHIPPED / f"{settings.name}.toml"), end="")


def coordinate_count(scene: Scene) -> int:
    """How many coordinates the strain of a scene has."""
    grid = make_grid(scene, INTERVALS)
    return make_strain(scene, grid, at_points(scene, grid)).size
