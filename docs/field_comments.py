"""Fields of classes as one table in the API pages, with the comment beside or above each: shapes
and units stand there, `q: Array  # (n,)`."""

import ast
import re
from typing import Any

import griffe
import source_comments


class FieldComments(griffe.Extension):
    """Turns the annotated fields of a class without docstrings of their own into the section
    "Attributes" of the class."""

    def on_class_members(self, *, cls: griffe.Class, **kwargs: Any) -> None:
        fields = [
            field
            for field in cls.attributes.values()
            if not field.name.startswith("_") and is_field(field)
        ]
        if not fields or cls.docstring is None:
            return
        if not any(
            section.kind is griffe.DocstringSectionKind.attributes
            for section in cls.docstring.parsed
        ):
            rows = [
                griffe.DocstringAttribute(
                    field.name, description=description(field), annotation=field.annotation
                )
                for field in fields
            ]
            cls.docstring.parsed.append(griffe.DocstringSectionAttributes(rows))
        for field in fields:
            cls.del_member(field.name)


def is_field(attribute: griffe.Attribute) -> bool:
    """Whether it is annotated in the class itself: those of NamedTuples, dataclasses and
    configurations are, properties and class variables are not."""
    of_class = {"class-attribute", "instance-attribute"} & attribute.labels == {"class-attribute"}
    return (
        attribute.annotation is not None
        and attribute.docstring is None
        and "property" not in attribute.labels
        and not of_class
    )


def description(field: griffe.Attribute) -> str:
    """The comment beside or above a field, or the description of its pydantic Field, and its
    default."""
    value = str(field.value) if field.value is not None else ""
    text = comment(field)
    if text:
        texts = [text]
    else:
        quoted = re.findall(r"description=('[^']*'|\"[^\"]*\")", value)
        texts = [ast.literal_eval(words) for words in quoted]
    if value and "Field(" not in value:
        texts.append(f"default `{value}`")
    return "; ".join(texts)


def comment(field: griffe.Attribute) -> str:
    """The comment of a field; empty without any."""
    if not field.lines:
        return ""
    source = field.lines_collection[field.filepath]
    first = field.lineno
    return source_comments.comment(source, first, first + len(field.lines) - 1)
