"""Errors in one line: what ends a program that its user can do something about, and how exceptions of all kinds are worded."""


class Mishap(Exception):
    """What ends a program that has begun, and that its user can do something about: exit status 1 after one line, no traceback."""


def describe(error: BaseException) -> str:
    """An error in words: of an OSError the file comes first, without the number."""
    if isinstance(error, OSError) and error.strerror:
        names = ", ".join(str(name) for name in (error.filename, error.filename2) if name is not None)
        return f"{names}: {error.strerror}" if names else error.strerror
    if isinstance(error, MemoryError):
        return f"there is too little memory: {error}" if str(error) else "there is too little memory"
    return str(error) or type(error).__name__


def first_line(error: BaseException) -> str:
    """The type and the first line of an error of another library, at most 160 characters of it."""
    text = describe(error).strip().splitlines()
    return f"{type(error).__name__}, {text[0][:160]}" if text else type(error).__name__
