"""What to do about a connection that cannot be made, by what gRPC says of it."""

from __future__ import annotations

_NOT_CONNECTED = "failed to connect"

_ADVICE = {
    "certificate has expired": "the server's certificate has expired: it needs a new one",
    "certificate is not yet valid": "the server's certificate is not valid yet: check both clocks",
    "Hostname Verification Check failed": (
        "the server's certificate is for other names than this address: connect to one of them"
    ),
    "CERTIFICATE_VERIFY_FAILED": (
        "the server's certificate is of none of the authorities in tls_ca "
        "(--tls-ca; without it, the system's)"
    ),
    "WRONG_VERSION_NUMBER": (
        "the server does not encrypt: leave tls_ca, tls_cert and tls_key out (--tls-...)"
    ),
    "Socket closed": (
        "the server closed the connection at once: if it encrypts, it wants tls_ca (--tls-ca), "
        "and perhaps tls_cert and tls_key with a valid certificate of its authorities; "
        "or it has too many connections"
    ),
    "Connection refused": "no server listens there",
}
"""By what an error says; the first that fits counts."""


def advice(details: str) -> str:
    """Return what to do about an error of gRPC; empty if that is unknown."""
    if _NOT_CONNECTED not in details:
        return ""
    return next((text for sign, text in _ADVICE.items() if sign in details), "")
