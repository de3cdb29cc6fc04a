"""Kinds of files by their first bytes, for errors about a file that is no table of text."""

import contextlib
from pathlib import Path

BEGINNINGS = {
    b"PK": "a ZIP archive, such as a spreadsheet (.xlsx)",
    b"\xd0\xcf\x11\xe0": "an old spreadsheet (.xls)",
    b"\x89HDF": "an HDF5 file",
    b"MATLAB": "a MATLAB file, which should be named *.mat",
    b"\x93NUMPY": "a NumPy array (.npy)",
    b"PAR1": "a Parquet file",
    b"\x89PNG": "a picture (PNG)",
    b"\xff\xd8\xff": "a picture (JPEG)",
    b"%PDF": "a PDF document",
    b"\x1f\x8b": "a compressed file (gzip)",
    b"{": "JSON",
    b"<": "XML or HTML",
}
"""Kind of a file by its first bytes."""
C3D = 0x50
"""Second byte of a C3D file of motion capture."""
LOOKED_AT = 4096
"""Bytes at the beginning that are looked at."""


def check_is_text(path: Path) -> None:
    """Checks that a file may be a table of text, by its first bytes.

    Args:
        path: of the file; one that cannot be opened is left to its reader.

    Raises:
        ValueError: with what the file seems to be, and never its contents.
    """
    start = b""
    with contextlib.suppress(OSError), path.open("rb") as file:
        start = file.read(LOOKED_AT)
    # a byte order mark says UTF-16, which the reader of text tells
    if start.startswith((b"\xff\xfe", b"\xfe\xff")):
        return
    kind = ""
    for beginning, name in BEGINNINGS.items():
        if start.lstrip().startswith(beginning):
            kind = name
    mark = bytes([C3D])
    has_mark = start[1:2] == mark
    if has_mark and start[0] < 32:
        kind = "a C3D file of motion capture"
    # blocks that never came to the disk are zeros at the end of a text
    if not kind and b"\0" in start.rstrip(b"\0"):
        kind = "of bytes that are no text"
    if kind:
        raise ValueError(
            f"{path} is {kind}: it should be a table as text (CSV), or a .mat or .npz file"
        )
