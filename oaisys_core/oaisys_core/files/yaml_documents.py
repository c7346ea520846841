"""YAML from outside, within bounds of size, nesting and repetition; text of others in comments."""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator
from typing import TYPE_CHECKING, Any

from oaisys_core.errors import one_line, quote
from oaisys_core.files.documents import (
    LONGEST_WHOLE,
    MAX_DEPTH,
    MAX_TEXT_BYTES,
    MAX_VALUES,
    DocumentError,
)

if TYPE_CHECKING:
    import yaml

LONGEST_NUMBER = 400
"""Characters of a number or a date in YAML; reading longer ones takes time with their square."""

_OF_TAGS = (LookupError, AttributeError, TypeError, ValueError, OverflowError)
"""What PyYAML raises for texts that their tags do not fit."""

_NUMBERS = tuple(f"tag:yaml.org,2002:{kind}" for kind in ("int", "float", "timestamp"))

_READ_DIFFERENTLY = re.compile(
    r"""[-+]?(
        0[0-9]+ | 0[0-7_]+                                    # base 8, or no number, in YAML 1.1
      | 0b[01_]+                                              # base 2 in 1.1 alone
      | [1-9][0-9_]*(:[0-5]?[0-9])+                           # base 60 in 1.1 alone
      | [0-9][0-9_]*(:[0-5]?[0-9])+\.[0-9_]*
      | (?=[^_]*_)([1-9][0-9_]* | 0x[0-9a-fA-F_]+)            # groups of digits in 1.1 alone
      | (?=[^_]*_)[0-9][0-9_]*\.[0-9_]*([eE][-+][0-9]+)?
    ) | (?=[^_]*_)\.[0-9][0-9_]*([eE][-+][0-9]+)?
      | [-+]0x[0-9a-fA-F]+                                    # signs of base 16 in 1.1 alone
      | 0o[0-7]+                                              # base 8 in 1.2 alone""",
    re.VERBOSE,
)
"""Numbers of YAML 1.1 or of the core schema of YAML 1.2 that are another, or text, in the other.

Not ``1e3`` and ``-.5``, text in YAML 1.1: where a number is expected, both versions give it.
"""


def yaml_comments(lines: Iterable[str]) -> str:
    r"""Return YAML comments that show texts of others, each in one line, however they break.

    >>> yaml_comments(["a key\nseed: 1", "\x1b[31m"])
    '# a key seed: 1\n# \\x1b[31m\n'
    """
    return "".join(f"# {one_line(line)}\n" for line in lines)


def parse_yaml(text: str) -> Any:
    """Return the data of the only document in a YAML text.

    Raises:
        DocumentError: It is not YAML, has a key twice, or is beyond the bounds of this module.
    """
    return parse_yaml_with_lines(text)[0]


def parse_yaml_with_lines(text: str) -> tuple[Any, yaml.Node | None]:
    """Return the data of the only document in a YAML text, and its nodes, which know their lines.

    Raises:
        DocumentError: It is not YAML, has a key twice, or is beyond the bounds of this module.
    """
    import yaml

    if len(text) > MAX_TEXT_BYTES:
        raise DocumentError(f"it has {len(text)} characters, more than {MAX_TEXT_BYTES}")
    loader_class = getattr(yaml, "CSafeLoader", yaml.SafeLoader)
    root = None
    try:
        _check_events(yaml.parse(text, Loader=loader_class))
        root = yaml.compose(text, Loader=loader_class)
        if root is None:
            return None, None
        _check_expansion(root)
        _check_repeats(root)
        # Merge keys change the nodes, which the caller wants as they are in the file.
        data = yaml.load(text, Loader=loader_class)  # noqa: S506
    except DocumentError:
        raise
    except (yaml.YAMLError, RecursionError) as error:
        raise DocumentError(str(error)) from error
    except _OF_TAGS as error:
        raise DocumentError(_misfit(root)) from error
    return data, root


def _check_events(events: Iterator[yaml.Event]) -> None:
    """Raise if collections are nested too deeply for the composer, which calls itself.

    Raise also for a number that versions of YAML read differently.
    """
    import yaml

    depth = 0
    for event in events:
        if isinstance(event, yaml.CollectionStartEvent):
            depth += 1
            if depth > MAX_DEPTH:
                line = _line(event.start_mark)
                raise DocumentError(f"line {line} is nested more than {MAX_DEPTH} times")
        elif isinstance(event, yaml.CollectionEndEvent):
            depth -= 1
        elif isinstance(event, yaml.ScalarEvent) and _READ_DIFFERENTLY.fullmatch(event.value):
            is_plain = event.implicit[0]  # neither in quotes nor with a tag
            if is_plain or event.tag in _NUMBERS[:2]:
                raise DocumentError(
                    f"line {_line(event.start_mark)}: received {quote(event.value)}, which versions"
                    " of YAML read differently, expected a number with base 10 or a text in quotes"
                )


def _check_expansion(root: yaml.Node) -> None:
    """Raise if a document is too large or too deep after its aliases are replaced."""
    import yaml

    sizes: dict[int, tuple[int, int] | None] = {}

    def measure(node: yaml.Node) -> tuple[int, int]:
        line = _line(node.start_mark)
        if id(node) in sizes:
            known = sizes[id(node)]
            if known is None:
                raise DocumentError(f"line {line}: an alias stands for what contains it")
            return known
        if isinstance(node, yaml.ScalarNode):
            if node.tag in _NUMBERS and len(node.value) > LONGEST_NUMBER:
                raise DocumentError(f"line {line}: a number of more than {LONGEST_NUMBER} digits")
            if node.tag == _NUMBERS[0] and len(node.value) > LONGEST_WHOLE:
                expected = f"at most {LONGEST_WHOLE} digits of a whole number"
                raise DocumentError(f"line {line}: {quote(node.value)}, expected {expected}")
            return 1, 0
        sizes[id(node)] = None
        children = [measure(child) for child in _children(node)]
        size, depth = 1 + sum(s for s, _ in children), 1 + max((d for _, d in children), default=0)
        if size > MAX_VALUES:
            expected = f"more than {MAX_VALUES} values, aliases replaced"
            raise DocumentError(f"line {line}: {expected}")
        if depth > MAX_DEPTH:
            raise DocumentError(f"line {line} is nested more than {MAX_DEPTH} times")
        sizes[id(node)] = size, depth
        return size, depth

    measure(root)


def _check_repeats(root: yaml.Node) -> None:
    """Raise if a mapping has a key twice; YAML 1.2, 3.2.1.3: keys are unique.

    A key that a merge brings, too, is none: YAML says which of both counts.
    """
    import yaml

    for node in _each_node(root):
        if not isinstance(node, yaml.MappingNode):
            continue
        lines: dict[tuple[str, str], int] = {}
        for key, _ in node.value:
            name, line = (key.tag, str(key.value)), _line(key.start_mark)
            if name in lines:
                where = f"lines {lines[name]} and {line}" if lines[name] != line else f"line {line}"
                raise DocumentError(f"the key {quote(name[1])} stands twice, on {where}")
            lines[name] = line


def _misfit(root: yaml.Node | None) -> str:
    """Return what is wrong with the first scalar whose text its tag does not fit."""
    import yaml

    loader = yaml.SafeLoader("")
    for node in () if root is None else _each_node(root):
        if not isinstance(node, yaml.ScalarNode):
            continue
        try:
            loader.construct_object(node)
        except yaml.YAMLError:
            continue
        except _OF_TAGS as error:
            tag = node.tag.replace("tag:yaml.org,2002:", "!!")
            expected = f"what {quote(tag)} may be"
            if node.tag == _NUMBERS[2] and isinstance(error, ValueError):
                expected = f"a date and time that exist ({error}), or a text in quotes"
            received = f"line {_line(node.start_mark)}: received {quote(node.value)}"
            return f"{received}, expected {expected}"
    return "a value is not what its tag says"


def _line(mark: Any) -> int:
    return int(mark.line) + 1


def _each_node(root: yaml.Node) -> Iterator[yaml.Node]:
    """Yield each node of a document once, whatever aliases stand for it."""
    import yaml

    seen: set[int] = set()
    nodes = [root]
    while nodes:
        node = nodes.pop()
        if id(node) in seen:
            continue
        seen.add(id(node))
        yield node
        if not isinstance(node, yaml.ScalarNode):
            nodes.extend(_children(node))


def _children(node: yaml.Node) -> Iterator[yaml.Node]:
    for value in node.value:
        if isinstance(value, tuple):
            yield from value
        else:
            yield value
