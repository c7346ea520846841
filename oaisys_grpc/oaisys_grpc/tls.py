"""Keys and certificates of server and client."""

from __future__ import annotations

import ssl
from dataclasses import dataclass
from pathlib import Path

import grpc

from oaisys_core.errors import InvalidInputError
from oaisys_core.files.documents import MAX_TEXT_BYTES, DocumentError, read_bytes
from oaisys_core.files.folders import user_path


@dataclass(frozen=True)
class ServerTls:
    """How a server authenticates itself and its clients; all files are PEM.

    Attributes:
        cert: The server's certificate chain.
        key: Its private key, not encrypted.
        client_ca: Authorities whose clients may connect; None: anyone may.
    """

    cert: Path
    key: Path
    client_ca: Path | None = None

    @classmethod
    def of(cls, cert: Path | None, key: Path | None, client_ca: Path | None) -> ServerTls | None:
        """Return the TLS of three options; None if none is given.

        Raises:
            InvalidInputError: One of them is missing.
        """
        if cert is None and key is None and client_ca is None:
            return None
        if cert is None or key is None:
            field = "--tls-cert" if cert is None else "--tls-key"
            raise InvalidInputError(field, None, "certificate and key: TLS needs both")
        return cls(cert, key, client_ca)

    def credentials(self) -> grpc.ServerCredentials:
        """Return credentials for a port.

        Raises:
            InvalidInputError: A file cannot be used; the message never quotes its content.
        """
        pair = _pair(self.cert, self.key, "--tls-cert", "--tls-key")
        client_ca = (
            None if self.client_ca is None else _authority(self.client_ca, "--tls-client-ca")
        )
        return grpc.ssl_server_credentials(
            [pair], root_certificates=client_ca, require_client_auth=client_ca is not None
        )


@dataclass(frozen=True)
class ClientTls:
    """How a client authenticates its server and itself; all files are PEM.

    Attributes:
        ca: Authorities of the server's certificate; None: the system's.
        cert: The client's own certificate, if the server requires one.
        key: Its private key, not encrypted.
    """

    ca: Path | None = None
    cert: Path | None = None
    key: Path | None = None

    def credentials(self) -> grpc.ChannelCredentials:
        """Return credentials for a channel.

        Raises:
            InvalidInputError: A file cannot be used, or one of certificate and key is missing.
        """
        if (self.cert is None) != (self.key is None):
            field = "tls_cert" if self.cert is None else "tls_key"
            raise InvalidInputError(field, None, "certificate and key, or none of them")
        ca = None if self.ca is None else _authority(self.ca, "tls_ca")
        if self.cert is None or self.key is None:
            return grpc.ssl_channel_credentials(ca)
        key, cert = _pair(self.cert, self.key, "tls_cert", "tls_key")
        return grpc.ssl_channel_credentials(ca, key, cert)


def client_tls(
    ca: Path | str | None, cert: Path | str | None, key: Path | str | None
) -> ClientTls | None:
    """Return the TLS of three paths, each of which may be empty or None; None: without TLS.

    Raises:
        InvalidInputError: A path begins with ``~`` of a user who does not exist.
    """
    if not (ca or cert or key):
        return None
    named = {"tls_ca": ca, "tls_cert": cert, "tls_key": key}
    return ClientTls(*(user_path(path, name) if path else None for name, path in named.items()))


def _pair(cert: Path, key: Path, cert_field: str, key_field: str) -> tuple[bytes, bytes]:
    """Return a private key and its certificate, checked, because gRPC does not check them."""
    chain, private = _read(cert, cert_field), _read(key, key_field)
    _require_certificates(cert, cert_field, "a certificate in PEM")
    try:
        # Without a password, OpenSSL would ask for one on the terminal.
        ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER).load_cert_chain(cert, key, password="")
    except (OSError, ValueError) as error:
        expected = f"a private key in PEM, not encrypted, that fits the certificate {cert}"
        raise InvalidInputError(key_field, str(key), expected) from error
    return private, chain


def _authority(path: Path, field: str) -> bytes:
    data = _read(path, field)
    _require_certificates(path, field, "certificates of authorities in PEM")
    return data


def _require_certificates(path: Path, field: str, expected: str) -> None:
    try:
        ssl.SSLContext(ssl.PROTOCOL_TLS_CLIENT).load_verify_locations(path)
    except (OSError, ValueError) as error:
        raise InvalidInputError(field, str(path), expected) from error


def _read(path: Path, field: str) -> bytes:
    try:
        return read_bytes(path, MAX_TEXT_BYTES)
    except (OSError, DocumentError) as error:
        expected = f"a readable file ({getattr(error, 'strerror', None) or error})"
        raise InvalidInputError(field, str(path), expected) from error
