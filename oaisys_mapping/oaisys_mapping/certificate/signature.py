"""Ed25519 signatures of certificates (RFC 8032), with keys in PEM files."""

from __future__ import annotations

from pathlib import Path

from cryptography.exceptions import InvalidSignature
from cryptography.hazmat.primitives import serialization
from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey, Ed25519PublicKey

from oaisys_core.errors import InvalidInputError

ALGORITHM = "Ed25519"

PrivateKey = Ed25519PrivateKey


def read_private_key(path: Path) -> PrivateKey:
    """Return the unencrypted key in a PEM file (``openssl genpkey -algorithm ed25519``).

    Raises:
        InvalidInputError: The file does not contain such a key.
    """
    try:
        key = serialization.load_pem_private_key(path.read_bytes(), password=None)
    except (OSError, ValueError, TypeError) as error:
        expected = f"a PEM file with an Ed25519 key that is not encrypted ({error})"
        raise InvalidInputError("--key", str(path), expected) from error
    if not isinstance(key, Ed25519PrivateKey):
        raise InvalidInputError("--key", type(key).__name__, "an Ed25519 key")
    return key


def read_public_key(path: Path) -> str:
    """Return the public key in a PEM file, or that of its private key, as hexadecimal digits.

    Raises:
        InvalidInputError: The file does not contain such a key.
    """
    try:
        data = path.read_bytes()
        if b"PRIVATE" in data:
            return public_key_of(read_private_key(path))
        key = serialization.load_pem_public_key(data)
    except (OSError, ValueError) as error:
        raise InvalidInputError("--public-key", str(path), f"a PEM file ({error})") from error
    if not isinstance(key, Ed25519PublicKey):
        raise InvalidInputError("--public-key", type(key).__name__, "an Ed25519 key")
    return key.public_bytes_raw().hex()


def public_key_of(key: PrivateKey) -> str:
    """Return the public key of a private key as hexadecimal digits."""
    return key.public_key().public_bytes_raw().hex()


def sign(message: bytes, key: PrivateKey) -> dict[str, str]:
    """Return the signature of a message as JSON values; verified by `is_signature_of`."""
    return {
        "algorithm": ALGORITHM,
        "public_key": public_key_of(key),
        "value": key.sign(message).hex(),
    }


def is_signature_of(signature: object, message: bytes) -> bool:
    """Return whether a signature from `sign` is valid for a message."""
    try:
        assert isinstance(signature, dict)
        key = Ed25519PublicKey.from_public_bytes(bytes.fromhex(signature["public_key"]))
        key.verify(bytes.fromhex(signature["value"]), message)
    except (AssertionError, KeyError, TypeError, ValueError, InvalidSignature):
        return False
    return bool(signature.get("algorithm") == ALGORITHM)
