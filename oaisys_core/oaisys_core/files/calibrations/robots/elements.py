"""XML from outside as a tree that knows its lines, and what of it nobody has read."""

from __future__ import annotations

import math
import re
from collections.abc import Iterator
from typing import Any
from xml.parsers import expat

from oaisys_core.errors import InvalidInputError, one_of
from oaisys_core.files.documents import MAX_DEPTH
from oaisys_core.files.numbers import float_of

FIELD = "robot"
MOST_ELEMENTS = 200_000

XACRO = re.compile(r"\$\{|\$\((?:find|arg|env|optenv|eval|dirname|anon|cwd)\b")
"""What xacro replaces in texts."""

XACRO_COMMAND = "a file without xacro: `xacro robot.urdf.xacro -o robot.urdf` expands it"


class XmlElement:
    """An element of an XML file.

    Attributes:
        tag: Its name, with its prefix.
        attributes: Texts by name.
        line: Line in the file, from 1.
        text: Text directly in it, without blanks around it.
        children: The elements in it.
        is_read: Whether somebody has asked for it.
    """

    def __init__(self, tag: str, attributes: dict[str, str], line: int) -> None:
        self.tag, self.attributes, self.line = tag, attributes, line
        self.text = ""
        self.children: list[XmlElement] = []
        self.is_read = False

    @property
    def where(self) -> str:
        """The name of this element in errors."""
        return f"{FIELD}: line {self.line}: <{self.tag}>"

    @property
    def name(self) -> str:
        """The attribute ``name``, which must be there.

        Raises:
            InvalidInputError: It is missing or empty.
        """
        return self.attribute("name")

    def attribute(self, key: str) -> str:
        """Return an attribute.

        Raises:
            InvalidInputError: It is missing or empty.
        """
        if not (found := self.attributes.get(key, "").strip()):
            raise InvalidInputError(self.where, f"no {key}", f'{key}="..."')
        return found

    def check_attributes(self, *keys: str) -> None:
        """Raise if this element has attributes that nobody reads; those of a namespace may be.

        Raises:
            InvalidInputError: It has another one, which may be one of the keys, misspelt.
        """
        for key in self.attributes:
            if key not in keys and ":" not in key:
                raise InvalidInputError(self.where, key, one_of(list(keys), key))

    def all(self, *tags: str) -> list[XmlElement]:
        """Return the elements in this one that have one of the names, and count them as read."""
        found = [child for child in self.children if child.tag in tags]
        for child in found:
            child.is_read = True
        return found

    def child(self, *tags: str) -> XmlElement | None:
        """Return the only element in this one that has one of the names; None without one.

        Raises:
            InvalidInputError: There are several that differ.
        """
        found = self.all(*tags)
        if len(found) > 1 and not all(map(found[0].is_like, found[1:])):
            lines = " and ".join(str(each.line) for each in found[:2])
            raise InvalidInputError(found[1].where, f"lines {lines}", "one such element")
        return found[0] if found else None

    def is_like(self, other: XmlElement) -> bool:
        """Return whether another element says the same."""
        return (
            (self.tag, self.attributes, self.text) == (other.tag, other.attributes, other.text)
            and len(self.children) == len(other.children)
            and all(a.is_like(b) for a, b in zip(self.children, other.children, strict=True))
        )

    def require(self, *tags: str) -> XmlElement:
        """Return the only element in this one that has one of the names.

        Raises:
            InvalidInputError: There is none, or there are several.
        """
        found = self.child(*tags)
        if found is None:
            raise InvalidInputError(self.where, f"no <{tags[0]}>", f"<{tags[0]}> in it")
        return found

    def value(self, tag: str, default: str | None = None) -> str | None:
        """Return the text of an element in this one, or the default where there is no text."""
        found = self.child(tag)
        return default if found is None or not found.text else found.text

    def number(self, tag: str, default: float | None = None) -> float:
        """Return the number in an element of this one; None as a default: it must be there."""
        found = self.require(tag) if default is None else self.child(tag)
        if found is None:
            return float(default or 0.0)
        return found.numbers(1)[0]

    def numbers(self, count: int, *, text: str | None = None) -> list[float]:
        """Return the finite numbers in the text of this element, or in another text of it.

        Raises:
            InvalidInputError: They are none, or not ``count``.
        """
        words = (self.text if text is None else text).split()
        try:
            found = [float_of(word) for word in words]
        except ValueError:
            found = [math.nan]
        if len(found) != count or not all(map(math.isfinite, found)):
            shown = self.text if text is None else text
            wanted = "a finite number" if count == 1 else f"{count} finite numbers"
            raise InvalidInputError(self.where, shown, wanted)
        return found

    def mark_read(self) -> None:
        """Count everything in this element as read."""
        for child in self.children:
            child.is_read = True
            child.mark_read()

    def unread(self, prefix: str = "") -> Iterator[str]:
        """Yield the names of elements in this one that nobody has read, such as ``scan/noise``."""
        for child in self.children:
            if not child.is_read:
                yield f"{prefix}{child.tag}"
            else:
                yield from child.unread(f"{prefix}{child.tag}/")


def parse_xml(data: bytes) -> XmlElement:
    """Return the root of an XML file.

    Raises:
        InvalidInputError: It is not XML, has a DOCTYPE, is nested more than `MAX_DEPTH` times,
            has more than `MOST_ELEMENTS` elements, or has to be expanded by xacro.
    """
    # Gazebo reads files with empty lines before the declaration, which XML does not allow.
    start = data.lstrip(b"\xef\xbb\xbf \t\r\n")
    skipped = data[: len(data) - len(start)] if start.startswith(b"<?xml") else b""
    builder = _Builder(skipped.count(b"\n"))
    try:
        builder.parser.Parse(data[len(skipped) :], True)
    except (expat.ExpatError, ValueError, LookupError) as error:
        raise InvalidInputError(FIELD, "an XML file", f"one that can be read ({error})") from error
    assert builder.root is not None  # expat refuses documents without elements
    return builder.root


class _Builder:
    """Builds the tree while expat reads, within the bounds."""

    def __init__(self, lines_before: int) -> None:
        self._lines_before = lines_before
        self.root: XmlElement | None = None
        self._open: list[XmlElement] = []
        self._texts: list[list[str]] = []
        self._count = 0
        self.parser = expat.ParserCreate()
        self.parser.buffer_text = True
        self.parser.StartElementHandler = self._start
        self.parser.EndElementHandler = self._end
        self.parser.CharacterDataHandler = self._characters
        self.parser.StartDoctypeDeclHandler = self._refuse_doctype

    def _start(self, tag: str, attributes: dict[str, str]) -> None:
        line = self.parser.CurrentLineNumber + self._lines_before
        self._count += 1
        if len(self._open) >= MAX_DEPTH or self._count > MOST_ELEMENTS:
            expected = f"at most {MAX_DEPTH} levels and {MOST_ELEMENTS} elements"
            raise InvalidInputError(FIELD, f"more at line {line}", expected)
        if tag.startswith("xacro:") or any(map(XACRO.search, attributes.values())):
            raise InvalidInputError(f"{FIELD}: line {line}", _shown(tag, attributes), XACRO_COMMAND)
        element = XmlElement(tag, attributes, line)
        if self._open:
            self._open[-1].children.append(element)
        else:
            self.root = element
        self._open.append(element)
        self._texts.append([])

    def _end(self, tag: str) -> None:
        element = self._open.pop()
        element.text = "".join(self._texts.pop()).strip()
        if XACRO.search(element.text):
            raise InvalidInputError(element.where, element.text, XACRO_COMMAND)

    def _characters(self, text: str) -> None:
        self._texts[-1].append(text)

    def _refuse_doctype(self, name: str, *_: Any) -> None:
        # Entities are declared there, in the file or elsewhere, and expat drops unknown ones.
        line = self.parser.CurrentLineNumber + self._lines_before
        shown = f"<!DOCTYPE {name[:40]}>"
        raise InvalidInputError(f"{FIELD}: line {line}", shown, "XML without DOCTYPE and entities")


def _shown(tag: str, attributes: dict[str, str]) -> str:
    if tag.startswith("xacro:"):
        return f"<{tag}>"
    key, text = next((key, text) for key, text in attributes.items() if XACRO.search(text))
    return f'{key}="{text[:60]}"'
