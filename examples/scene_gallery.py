"""Gallery of the scenes that ship: a picture of each, its first tendon pulled, and a page that
describes them.

    python examples/scene_gallery.py [SCENE ...] [--out out/scenes] [--page out/scenes.md]

A picture that is there is left as it is, unless its scene is named. Needs the extra `pictures`.
"""

import argparse
from pathlib import Path

import numpy as np
from _palette import with_palette
from tqdm import tqdm

import soft_tendon_env as ste
from soft_tendon_env.drawing.renderer import ArmRenderer, Picture
from soft_tendon_env.evaluation.tables import write_markdown
from soft_tendon_env.scene.file import scene_names

FIDELITY = "standard"
SHARE = 0.5  # of its limit, with which the first tendon pulls
SIZE = 1280, 960  # [pixels]
HEAD = """# Scenes that ship

A scene describes an arm: geometry, material, tendons, effects. Name one in
`gym.make("TendonRod-TipPose-v0", scene="three_tendon")` or `load_scene("three_tendon")`.
`soft-tendon scenes NAME` prints it as TOML, as a start for your own.
"""


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument(
        "scenes",
        nargs="*",
        metavar="SCENE",
        help="scenes to draw again; of the others, those without a picture are drawn",
    )
    parser.add_argument(
        "--out", type=Path, default=Path("out/scenes"), help="folder of the pictures"
    )
    parser.add_argument(
        "--page", type=Path, default=Path("out/scenes.md"), help="the page, for docs/reference"
    )
    arguments = parser.parse_args()
    unknown = {*arguments.scenes} - {*scene_names()}
    if unknown:
        parser.error(
            f"{min(unknown)!r} is not among the scenes that ship: {', '.join(scene_names())}"
        )
    folder = arguments.out
    folder.mkdir(parents=True, exist_ok=True)
    drawn = [
        name
        for name in scene_names()
        if name in arguments.scenes or not (folder / f"{name}.png").exists()
    ]
    for name in tqdm(drawn, desc="scenes", unit="scene"):
        with_palette([picture(name)])[0].save(folder / f"{name}.png", optimize=True)
    write_markdown(arguments.page, "\n".join([HEAD, *map(section, scene_names())]))


def picture(name: str) -> np.ndarray:
    """A frame (height, width, 3) of the arm at rest, its first tendon pulled. Raises RuntimeError
    where it comes to none."""
    model = ste.build_model(ste.load_scene(name), FIDELITY)
    tension = np.zeros(model.tendon_count)
    tension[0] = SHARE * model.scene.tendons[0].tension_limits[1]
    rest = ste.static_equilibrium(model, tension)
    if not rest.converged:
        raise RuntimeError(f"{name}: {rest.reason}")
    title = f"tension of the first tendon {tension[0]:g} N"
    return ArmRenderer(model, *SIZE).frame(
        Picture(model.strain(rest.q)[1], tension, np.empty((0, 3)), None, None, title)
    )


def section(name: str) -> str:
    """Markdown of a scene."""
    scene = ste.load_scene(name)
    effects = [f"`{effect}`" for effect in scene.effects.model_dump(exclude_none=True)]
    length = sum(segment.length for segment in scene.segments)
    acts = f", effects: {', '.join(effects)}" if effects else ""
    text = f"{scene.description}. {length:g} m, {len(scene.tendons)} tendons{acts}."
    tension = SHARE * scene.tendons[0].tension_limits[1]
    picture = f"![{scene.description}](../pictures/scenes/{name}.png)"
    caption = f"*At rest, while the first tendon (orange) pulls with {tension:g} N.*"
    return f"\n## `{name}`\n\n{text}\n\n{picture}\n\n{caption}"


if __name__ == "__main__":
    main()
