"""What rclpy raises at arguments that it cannot use.

Private part: ``RCLError`` and ``UnknownROSArgsError`` of rclpy's module in C.
Tried with: rclpy 7.1.6.
Public way without it: their base, ``RuntimeError``.
Lost without it: the traceback of an error that has nothing to do with arguments.
"""

from __future__ import annotations

from typing import Any

from rclpy.exceptions import NameValidationException, ParameterException
from rclpy.impl import implementation_singleton

from oaisys_core.system.fallbacks import report_fallback

PUBLIC = NameValidationException, ParameterException, UnicodeEncodeError
"""Errors that need no private part: of names, of one's own parameters, of what is no UTF-8."""

NAMES = "RCLError", "UnknownROSArgsError"
"""Names of the others."""


def argument_errors() -> tuple[type[Exception], ...]:
    """Return the classes of the errors."""
    module: Any = getattr(implementation_singleton, "rclpy_implementation", None)
    found = [getattr(module, name, None) for name in NAMES]
    if None in found:
        reason = f"rclpy has no {' or no '.join(NAMES)}"
        report_fallback("rclpy's errors", reason, "every RuntimeError counts as one of arguments")
        found = [RuntimeError]
    return (*(each for each in found if each is not None), *PUBLIC)
