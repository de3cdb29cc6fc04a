"""Versions of packages, and whether they are within bounds such as ">=0.63.1,<0.69"."""

import operator
import re

_COMPARISONS = {">=": operator.ge, "<": operator.lt, "==": operator.eq}


def fits(version: str, bounds: str) -> bool:
    """Whether a release is within all bounds, of the kinds ">=1.2", "<2" and "==1.2.3". Raises KeyError for bounds of other kinds."""
    found = [re.fullmatch(r"\s*([<>=!~]+)(.*)", bound) for bound in bounds.split(",")]
    return all(_COMPARISONS[bound[1]](release(version), release(bound[2])) for bound in found if bound)


def release(version: str) -> tuple[int, ...]:
    """The numbers of a version up to what marks a trial or a build: (2, 13) of "2.13.0+cpu"; zeros at the end tell nothing apart."""
    numbers = re.match(r"\d+(\.\d+)*", version.strip())
    return tuple(int(number) for number in re.sub(r"(\.0+)+$", "", numbers[0]).split(".")) if numbers else ()
