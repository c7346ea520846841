"""Links between pages of the repository, as they are on the site."""

from __future__ import annotations

import os
import re
from collections.abc import Mapping
from pathlib import Path, PurePosixPath

from tools.programs import ROOT

REPOSITORY_URL = "https://github.com/oaisys/interactive-oaisys/blob/main"

_LINK = re.compile(r"(!?\[(?:[^\]\[]|\[[^\]]*\])*\]\()([^)\s]+)(\))")
_DEFINITION = re.compile(r"^(\[[^\]]+\]: )(\S+)()$", re.MULTILINE)
_CODE = re.compile(r"(^ *```.*?^ *```|`[^`\n]+`)", re.DOTALL | re.MULTILINE)


class SiteLinks:
    """Turns links between files of the repository into links between pages of the site.

    Args:
        places: Places on the site of pages and pictures, by path relative to the repository.
    """

    def __init__(self, places: Mapping[Path, Path]) -> None:
        self._places = {source.as_posix(): target for source, target in places.items()}

    def rewrite(self, text: str, source: Path) -> str:
        """Return a page with the links that it has on the site; code stays as it is.

        Args:
            text: Markdown.
            source: Where the page is in the repository.

        Raises:
            FileNotFoundError: A link leads to a file that does not exist.
        """

        def replace(match: re.Match[str]) -> str:
            return match[1] + self._on_site(match[2], source) + match[3]

        parts = _CODE.split(text)
        parts[::2] = [_DEFINITION.sub(replace, _LINK.sub(replace, part)) for part in parts[::2]]
        # Code inside a link's text splits the link: such links are looked for in the whole.
        return _LINK_WITH_CODE.sub(replace, "".join(parts))

    def _on_site(self, link: str, source: Path) -> str:
        if re.match(r"[a-z]+:", link) or link.startswith(("#", REPOSITORY_URL)):
            return link
        name, hash_, anchor = link.partition("#")
        path = Path(os.path.normpath(source.parent / name)).as_posix()
        start = self._places[source.as_posix()].parent
        target = self._places.get(path) or _tutorial(path)
        if target is not None:
            return PurePosixPath(os.path.relpath(target, start)).as_posix() + hash_ + anchor
        if not (ROOT / path).exists():
            if (start / name) in {*self._places.values()}:
                return link  # rewritten already
            raise FileNotFoundError(f"{source}: the link {link} leads to no file")
        return f"{REPOSITORY_URL}/{path}{hash_}{anchor}"


_LINK_WITH_CODE = re.compile(r"(\[[^\]\[\n]*`[^`\n]+`[^\]\[\n]*\]\()([^)\s]+)(\))")


def _tutorial(path: str) -> Path | None:
    """Return the page of a numbered example; None for any other file."""
    match = re.fullmatch(r"examples/(\d\d_\w+)\.py", path)
    return Path("tutorials", f"{match[1]}.md") if match else None
