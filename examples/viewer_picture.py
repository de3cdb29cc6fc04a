"""A picture of what the Rerun viewer shows of a recording, made without a screen.

    python examples/viewer_picture.py out/demo.rrd out/demo_viewer.png [--time 2.6] [--width 1440]

For documents. On a machine without a graphics processor it needs Vulkan on the processor:
`apt-get install mesa-vulkan-drivers`.
"""

import argparse
import io
import sys
import time
from pathlib import Path

import numpy as np
from _palette import with_palette
from PIL import Image
from rerun.experimental import ViewerClient

PORT = 9877
MENU = 36  # [pixels] at the top, which say nothing about the recording
SECONDS = 8.0  # until the viewer has drawn everything and its greeting is gone


def main() -> None:
    arguments = parse_arguments()
    binary = str(Path(sys.executable).with_name("rerun"))  # which need not be on the PATH
    with ViewerClient.spawn(
        headless=True, port=PORT, hide_welcome_screen=True, executable_path=binary
    ) as viewer:
        viewer.open(str(arguments.recording.resolve()))
        viewer.set_time("sim_time", duration=arguments.time, play_state="paused")
        time.sleep(SECONDS)
        picture = Image.open(io.BytesIO(viewer.take_screenshot())).convert("RGB")
    picture = picture.crop((0, MENU, *picture.size))
    picture = picture.resize(
        (arguments.width, round(arguments.width * picture.height / picture.width)),
        Image.Resampling.LANCZOS,
    )
    arguments.picture.parent.mkdir(parents=True, exist_ok=True)
    with_palette([np.asarray(picture)])[0].save(arguments.picture, optimize=True)
    print(f"written: {arguments.picture}, {arguments.picture.stat().st_size / 1e3:.0f} kB")


def parse_arguments() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("recording", type=Path, help="a file (.rrd)")
    parser.add_argument("picture", type=Path, help="a file (.png)")
    parser.add_argument(
        "--time", type=float, default=2.6, help="that the viewer stands at [s] (default 2.6)"
    )
    parser.add_argument(
        "--width", type=int, default=1440, help="of the picture [pixels] (default 1440)"
    )
    return parser.parse_args()


if __name__ == "__main__":
    main()
