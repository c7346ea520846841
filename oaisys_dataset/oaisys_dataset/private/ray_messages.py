"""What Ray's daemons report, which Ray prints to the standard output of the command.

Private part: the function ``print_to_stdstream`` of the module ``ray._private.worker``.
Tried with: Ray 2.60.0.
Public way without it: none; ``log_to_driver`` is about what workers print.
Lost without it: a standard output without Ray's lines where a daemon dies.
"""

from __future__ import annotations

import os
import sys
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from typing import Any

from oaisys_core.system.fallbacks import report_fallback

MODULE, FUNCTION = "ray._private.worker", "print_to_stdstream"


@contextmanager
def write_reports_like_a_library() -> Iterator[None]:
    """Have reports go to the descriptor of standard error, as what C libraries write.

    See `oaisys_core.system.own_streams.keep_messages`, which leads it to a file.
    """
    module = sys.modules.get(MODULE)
    if not hasattr(module, FUNCTION):
        report_fallback("Ray's reports", f"no {FUNCTION} in {MODULE}", "Ray prints them")
        yield
        return
    before = getattr(module, FUNCTION)
    setattr(module, FUNCTION, _write)
    try:
        yield
    finally:
        setattr(module, FUNCTION, before)


def _write(data: Mapping[str, Any], *_: object, **__: object) -> None:
    text = "".join(f"{line}\n" for line in data.get("lines", ()))
    os.write(2, text.encode(errors="backslashreplace"))
