"""What a server takes at most, so that no request makes it allocate without bounds."""

from __future__ import annotations

MAX_REQUEST_BYTES = 4 * 1024 * 1024
"""Of one message to the server; a larger one ends with RESOURCE_EXHAUSTED, unread."""
