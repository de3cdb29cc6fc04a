"""Options of commands about one arm: its scene, and changes of it."""

from pydantic import Field

from soft_tendon_env.scene.file import load_scene
from soft_tendon_env.scene.scene import Scene
from soft_tendon_env.tools.configuration import Configuration, ConfigurationError, parsed_changes


class ArmSettings(Configuration):
    """The arm that a command is about."""

    scene: str = Field(description="a shipped scene's name, or the path of a TOML file")
    set: tuple[str, ...] = Field(default=(), description="changes of the scene, such as effects.gravity.acceleration=[0,0,-9.81]")

    def changed_scene(self) -> Scene:
        """The scene with the changes of --set. Raises ConfigurationError, ValueError."""
        scene = load_scene(self.scene)
        try:
            return scene.replace(parsed_changes(self.set)) if self.set else scene
        except ConfigurationError as error:
            raise ConfigurationError(error.problems, "--set") from error
