"""The mission's certificate authority: it exists while the dealer runs, and never on a disk.

Every robot gets a certificate for one DNS name, its own, and the authority's certificate to check the
others with. ECDSA P-256 with SHA-256, because every OpenSSL that Python 3.10 runs on takes it, in FIPS mode
too. Certificates are valid from 1970-01-01 to 9999-12-31 (RFC 5280, 4.1.2.5): a robot that boots without a
clock can still use them. What ends a mission is its tapes: they are used up; nothing is renewed or revoked.
"""

from __future__ import annotations

import contextlib
import os
import re
import secrets
from collections.abc import Collection
from dataclasses import dataclass, field
from datetime import datetime, timezone
from pathlib import Path

from cryptography import x509
from cryptography.hazmat.primitives import hashes, serialization
from cryptography.hazmat.primitives.asymmetric import ec
from cryptography.x509.oid import ExtendedKeyUsageOID, NameOID

from spdz.channels.tls import CA_FILE, CERTIFICATE_FILE, KEY_FILE
from spdz.tape.durable import create_private, make_private_folder, sync, sync_folder, write_at

_NOT_BEFORE = datetime(1970, 1, 1, tzinfo=timezone.utc)
_NOT_AFTER = datetime(9999, 12, 31, 23, 59, 59, tzinfo=timezone.utc)
_LONGEST_MISSION = 64  # ub-organization-name (RFC 5280, appendix A.1)
_ROBOT_NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9_-]{0,30}")


@dataclass(frozen=True, slots=True)
class Credentials:
    """What one robot takes on the mission, as PEM.

    Attributes:
        cert_pem: The robot's certificate.
        key_pem: Its private key, not encrypted (PKCS #8).
        ca_pem: The certificate of the mission's authority.
    """

    cert_pem: bytes
    key_pem: bytes = field(repr=False)
    ca_pem: bytes


def check_name(name: str, taken: Collection[str]) -> None:
    """Refuse a robot's name that is malformed or taken.

    Args:
        name: The name.
        taken: Names in use, in lower case.

    Raises:
        ValueError: saying which names will do.
    """
    if not _ROBOT_NAME.fullmatch(name):
        raise ValueError(
            "a robot's name is 1 to 31 letters, digits, '_' and '-', the first a letter or a digit, "
            f"not {name!r}"
        )
    if name.lower() in taken:
        raise ValueError(f"there is a robot of the name {name!r} already (upper and lower case count as one)")


class MissionAuthority:
    """Issues the certificates of one mission.

    Args:
        mission: The mission's id, 1 to 64 characters, written into every certificate; random by default.

    Raises:
        ValueError: if the id has another length.
    """

    def __init__(self, mission: str | None = None) -> None:
        self.mission = secrets.token_hex(16) if mission is None else mission
        if not 1 <= len(self.mission) <= _LONGEST_MISSION:
            raise ValueError(
                f"a mission's id has 1 to {_LONGEST_MISSION} characters, not {len(self.mission)}"
            )
        self._issued: set[str] = set()
        self._key: ec.EllipticCurvePrivateKey | None = ec.generate_private_key(ec.SECP256R1())
        self._certificate = _certificate(
            subject=(authority := self._subject("spdz mission authority")),
            public_key=self._key.public_key(),
            issuer=authority,
            issuer_key=self._key,
            extensions=[
                (x509.BasicConstraints(ca=True, path_length=0), True),
                (_key_usage(key_cert_sign=True), True),
            ],
        )

    def credentials(self, name: str) -> Credentials:
        """Issue a robot's key and certificate.

        Args:
            name: The robot's name: 1 to 31 of ``A-Z a-z 0-9 _ -``, the first a letter or a digit, so that
                it can be a ROS name and a folder too. No two robots may differ in case only.

        Raises:
            ValueError: if the name is malformed or has been used.
            RuntimeError: if the authority has forgotten its key.
        """
        if self._key is None:
            raise RuntimeError("this authority has forgotten its key; a new mission takes a new authority")
        check_name(name, self._issued)
        key = ec.generate_private_key(ec.SECP256R1())
        certificate = _certificate(
            subject=self._subject(name),
            public_key=key.public_key(),
            issuer=self._certificate.subject,
            issuer_key=self._key,
            extensions=[
                (x509.BasicConstraints(ca=False, path_length=None), True),
                (_key_usage(digital_signature=True), True),
                (
                    x509.ExtendedKeyUsage([ExtendedKeyUsageOID.SERVER_AUTH, ExtendedKeyUsageOID.CLIENT_AUTH]),
                    False,
                ),
                (x509.SubjectAlternativeName([x509.DNSName(name)]), False),
            ],
        )
        self._issued.add(name.lower())
        return Credentials(
            certificate.public_bytes(serialization.Encoding.PEM),
            key.private_bytes(
                serialization.Encoding.PEM, serialization.PrivateFormat.PKCS8, serialization.NoEncryption()
            ),
            self._certificate.public_bytes(serialization.Encoding.PEM),
        )

    def forget(self) -> None:
        """Drop the authority's private key: from here on nobody can join the mission.

        The memory is given back, not overwritten; Python cannot do that.
        """
        self._key = None

    def _subject(self, name: str) -> x509.Name:
        return x509.Name(
            [
                x509.NameAttribute(NameOID.ORGANIZATION_NAME, self.mission),
                x509.NameAttribute(NameOID.COMMON_NAME, name),
            ]
        )


def write_credentials(folder: Path, credentials: Credentials) -> None:
    """Write a robot's credentials, durably, as new files of mode 0600.

    Args:
        folder: Where to; created with mode 0700 if missing.
        credentials: The robot's credentials.

    Raises:
        FileExistsError: if one of the files exists; nothing is overwritten, and nothing new is left behind.
    """
    make_private_folder(folder)
    written: list[Path] = []
    try:
        for name, content in (
            (KEY_FILE, credentials.key_pem),
            (CERTIFICATE_FILE, credentials.cert_pem),
            (CA_FILE, credentials.ca_pem),
        ):
            descriptor = create_private(folder / name)
            written.append(folder / name)
            try:
                write_at(descriptor, 0, content)
                sync(descriptor)
            finally:
                os.close(descriptor)
    except BaseException:
        for path in written:
            with contextlib.suppress(OSError):
                path.unlink()
        raise
    sync_folder(folder)


def _certificate(
    *,
    subject: x509.Name,
    public_key: ec.EllipticCurvePublicKey,
    issuer: x509.Name,
    issuer_key: ec.EllipticCurvePrivateKey,
    extensions: list[tuple[x509.ExtensionType, bool]],
) -> x509.Certificate:
    """Sign a certificate with the given extensions (each with whether it is critical) and key identifiers."""
    builder = (
        x509.CertificateBuilder()
        .subject_name(subject)
        .issuer_name(issuer)
        .public_key(public_key)
        .serial_number(x509.random_serial_number())
        .not_valid_before(_NOT_BEFORE)
        .not_valid_after(_NOT_AFTER)
        .add_extension(x509.SubjectKeyIdentifier.from_public_key(public_key), critical=False)
        .add_extension(
            x509.AuthorityKeyIdentifier.from_issuer_public_key(issuer_key.public_key()), critical=False
        )
    )
    for extension, critical in extensions:
        builder = builder.add_extension(extension, critical=critical)
    return builder.sign(issuer_key, hashes.SHA256())


def _key_usage(*, digital_signature: bool = False, key_cert_sign: bool = False) -> x509.KeyUsage:
    return x509.KeyUsage(
        digital_signature=digital_signature,
        content_commitment=False,
        key_encipherment=False,
        data_encipherment=False,
        key_agreement=False,
        key_cert_sign=key_cert_sign,
        crl_sign=False,
        encipher_only=False,
        decipher_only=False,
    )
