"""Where a node stands among others: in a namespace, with the transforms it deals with.

Names of ours are relative, so a namespace moves them all. ROS's own names of transforms are not:
below a namespace they are remapped to ``NAMESPACE/tf`` and ``NAMESPACE/tf_static``. What belongs to
all of a machine stays where it is: ``/clock`` and ``/diagnostics``.
"""

from __future__ import annotations

import re

from oaisys_core.errors import InvalidInputError

TF = "/tf"
TF_STATIC = "/tf_static"

_NAMESPACE = re.compile(r"/?[A-Za-z][A-Za-z0-9_]*(/[A-Za-z][A-Za-z0-9_]*)*")


def require_namespace(namespace: str) -> None:
    """Raise `InvalidInputError` where this is none that ROS takes; empty is the root."""
    if namespace and not _NAMESPACE.fullmatch(namespace):
        raise InvalidInputError("namespace", namespace, "names like mars or lab/mars")


def placing_arguments(namespace: str) -> list[str]:
    """Return the ROS arguments that put a node into a namespace; none for the root."""
    if not namespace:
        return []
    rules = [f"__ns:=/{namespace.strip('/')}"]
    rules += [f"{topic}:={topic.removeprefix('/')}" for topic in (TF, TF_STATIC)]
    return ["--ros-args", *(argument for rule in rules for argument in ("-r", rule))]
