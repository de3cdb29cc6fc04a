"""Docstrings of the public names: what the pages of docs/api show has every argument and result.

Google's form, so that the site and an editor show tables of parameters. The layout of docstrings is
ruff's, by `make check`.
"""

import functools
import importlib
import inspect
import re
import types
from pathlib import Path

import pytest
import yaml

ROOT = Path(__file__).parents[2]
PAGES = sorted((ROOT / "docs" / "api").glob("*.md"))
DIRECTIVE = re.compile(r"^::: ([\w.]+)\n((?:    .*\n)*)", re.MULTILINE)
ENTRY = re.compile(r"^    (\w+(?:, \w+)*): \S", re.MULTILINE)
LONGEST = 25
"""Words of a first sentence."""


@functools.cache
def usual_filters():
    """Filters of mkdocs.yml: names that match one of them are not shown."""
    plugins = yaml.safe_load((ROOT / "mkdocs.yml").read_text(encoding="utf-8"))["plugins"]
    (settings,) = [plugin["mkdocstrings"] for plugin in plugins if "mkdocstrings" in plugin]
    return settings["handlers"]["python"]["options"]["filters"]


def resolve(path):
    """Object of a dotted path: the longest part of it that is a module, and attributes of that."""
    names = path.split(".")
    for count in range(len(names), 0, -1):
        try:
            value = importlib.import_module(".".join(names[:count]))
        except ModuleNotFoundError as error:
            if not path.startswith(error.name or "?"):
                raise  # a library is missing, not a module of this name
            continue
        for name in names[count:]:
            value = getattr(value, name)
        return value
    raise AssertionError(f"{path} is nowhere")


def is_shown(name, filters):
    return not any(re.search(pattern.removeprefix("!"), name) for pattern in filters)


def of_module(module, options, filters):
    """Public names of a module and their objects, as mkdocstrings chooses them."""
    if "members" in options:
        return {name: getattr(module, name) for name in options["members"]}
    own = [
        name
        for name, value in vars(module).items()
        if getattr(value, "__module__", None) == module.__name__
    ]
    names = getattr(module, "__all__", own)
    return {name: getattr(module, name) for name in names if is_shown(name, filters)}


def callables(page):
    """Classes, functions, methods and properties that a page shows, by name."""
    result = {}
    for path, block in DIRECTIVE.findall(page.read_text(encoding="utf-8") + "\n"):
        options = (yaml.safe_load(block) or {}).get("options", {})
        filters = options.get("filters", usual_filters())
        target = resolve(path)
        if isinstance(target, types.ModuleType):
            objects = of_module(target, options, filters)
        else:
            objects = {path.rpartition(".")[2]: target}
        for name, value in objects.items():
            if inspect.isclass(value):
                result[name] = value
                result |= methods(name, value, filters)
            elif inspect.isfunction(value):
                result[name] = value
    return result


def methods(name, kind, filters):
    """Methods and properties of a class's own, by their dotted names."""
    result = {}
    for key, value in vars(kind).items():
        member = getattr(value, "__func__", value)
        is_method = callable(member) and getattr(member, "__name__", "") == key
        is_property = isinstance(member, property | functools.cached_property)
        if is_shown(key, filters) and (is_method or is_property):
            result[f"{name}.{key}"] = member
    return result


def section(text, title):
    """Text below a heading of a docstring, up to the next one; empty without it."""
    match = re.search(rf"^{title}:\n((?:(?:    .*)?\n)*)", text + "\n", re.MULTILINE)
    if match is None:
        return ""
    return match[1]


def entries(text, title):
    """Names that a section describes."""
    return [name for names in ENTRY.findall(section(text, title)) for name in names.split(", ")]


def misfits(value, text):
    """Faults of a docstring beside what it is of, in words."""
    summary = text.partition("\n")[0]
    if not summary:
        return ["has no docstring"]
    faults = []
    if len(summary.split()) > LONGEST:
        faults.append(f"begins with a sentence of {len(summary.split())} words")
    if inspect.isclass(value):
        called = constructor(value)
    else:
        called = value
    if called is None or not callable(called):  # fields describe themselves, properties take none
        return faults
    signature = inspect.signature(called)
    parameters = [name for name in signature.parameters if name not in ("self", "cls")]
    described = [name for name in entries(text, "Args") if name != "self"]
    if described != parameters:
        faults.append(f"describes the arguments {described}, not {parameters}")
    returns = signature.return_annotation not in (None, "None", inspect.Signature.empty)
    has_result = bool(section(text, "Returns") or section(text, "Yields"))
    if not inspect.isclass(value) and returns != has_result:
        faults.append("returns nothing" if has_result else "does not say what it returns")
    return faults


def constructor(kind):
    """`__init__` that is written in the class; None where its fields, or a base, make it."""
    function = vars(kind).get("__init__")
    if not inspect.isfunction(function):
        return None
    file = function.__code__.co_filename
    if file != inspect.getsourcefile(kind):
        return None
    return function


def docstring(dotted, value, owners):
    """Docstring of an object; of a method that says less, that of the one which it overrides."""
    text = inspect.cleandoc(value.__doc__ or "")
    class_name, _, name = dotted.rpartition(".")
    owner = owners.get(class_name)
    if owner is None or "Args:" in text or "Returns:" in text:
        return text
    for base in owner.__mro__[1:]:
        overridden = vars(base).get(name)
        if overridden is None:
            continue
        declared = inspect.cleandoc(overridden.__doc__ or "")
        if "Args:" in declared or "Returns:" in declared:
            return declared
    return text


def test_docstrings_make_sense_without_the_name_above_them():
    """A reader of the site, or of a list, may not have it before the eyes."""
    openings = re.compile(r'^ *r?"""(?:What|Of|Where|The same|Likewise|See)\b.*', re.MULTILINE)
    sources = sorted((ROOT / "soft_tendon_env").rglob("*.py"))
    faults = [
        f"{path.relative_to(ROOT)}: {opening.strip()}"
        for path in sources
        for opening in openings.findall(path.read_text(encoding="utf-8"))
    ]
    assert sources
    assert not faults


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.stem)
def test_public_names_have_arguments_and_results(page):
    shown = callables(page)
    owners = {name: value for name, value in shown.items() if inspect.isclass(value)}
    faults = {}
    for name, value in shown.items():
        text = docstring(name, value, owners)
        texts = misfits(value, text)
        if texts:
            faults[name] = texts
    assert faults == {}


def test_the_pages_show_names():
    """Were directives or filters no longer understood, nothing would be checked."""
    shown = {name for page in PAGES for name in callables(page)}
    assert {"simulate", "Simulation.step", "Model.command_unit", "make_policy"} <= shown
    assert not {"Model.workspace", "Scene.model_config"} & shown


class Example:
    def __init__(self, size: int) -> None:
        self.size = size


def example(size: int, *others: int) -> int:
    return size + sum(others)


@pytest.mark.parametrize(
    ("value", "text", "count"),
    [
        (example, "", 1),
        (example, "Adds.\n\nArgs:\n    size: one.\n    others: more.\n\nReturns:\n    Sum.", 0),
        (example, "Adds.\n\nArgs:\n    size: one.\n\nReturns:\n    Sum.", 1),
        (example, "Adds.\n\nArgs:\n    size, others: all.\n", 1),
        (example, "Adds.", 2),
        (Example, "Size.\n\nArgs:\n    size: one.", 0),
        (Example, "Size.", 1),
        (Example, f"{'word ' * 26}.\n\nArgs:\n    size: one.", 1),
        (lambda: None, "Nothing.\n\nReturns:\n    None.", 1),
    ],
)
def test_what_is_wrong_with_a_docstring_is_found(value, text, count):
    assert len(misfits(value, text)) == count
