"""Names of the parameters that a node was started with, whether it has them or not.

Private part: ``_parameter_overrides`` of rclpy's `Node`.
Tried with: rclpy 7.1.6.
Public way without it: none: rclpy tells only of parameters that a node declares.
Lost without it: warnings of parameters that a node does not have.
"""

from __future__ import annotations

from collections.abc import Iterable

from rclpy.node import Node

from oaisys_core.system.fallbacks import report_fallback

OVERRIDES = "_parameter_overrides"
"""Name of the attribute: a mapping by parameter."""


def parameters_at_start(node: Node) -> Iterable[str]:
    """Return the names in a node's arguments and files of parameters; none where rclpy hides it."""
    found = getattr(node, OVERRIDES, None)
    if not isinstance(found, dict):
        lost = "parameters that a node does not have are ignored without a word"
        report_fallback("rclpy's parameters", f"a node has no {OVERRIDES}", lost)
        return ()
    return tuple(found)
