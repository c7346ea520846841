"""Text of others in Markdown that we write."""

from __future__ import annotations

import re
from html import escape

_SIGNS = re.compile(r"([\\`*_{}\[\]()#|!~])")


def escape_markdown(text: str) -> str:
    r"""Return Markdown that shows a text as it is, in one line: no HTML, no links, no formatting.

    >>> escape_markdown("<b>sand</b> [a](b)")
    '&lt;b&gt;sand&lt;/b&gt; \\\\[a\\\\]\\\\(b\\\\)'
    """
    return _SIGNS.sub(r"\\\1", escape(" ".join(text.split()), quote=False))
