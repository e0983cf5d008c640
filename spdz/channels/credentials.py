"""Credentials held against the tape that they are used with, before anybody is called.

TLS itself would tell the *peer* of a certificate that names another robot, or that another authority issued;
the robot with the wrong folder is the one that can do something about it.
"""

from __future__ import annotations

from pathlib import Path

from cryptography import x509
from cryptography.exceptions import InvalidSignature

from spdz.channels.tls import CA_FILE, CERTIFICATE_FILE, require_files


def check_credentials(folder: Path, robot: str) -> None:
    """Refuse credentials of another robot, and a certificate that the folder's authority did not issue.

    Args:
        folder: Folder of ``ca.pem``, ``cert.pem`` and ``key.pem``.
        robot: Whose they have to be: the robot that the tape names.

    Raises:
        ValueError: saying whose they are, or which file cannot be used.
    """
    require_files(folder)
    certificate, authority = _load(folder / CERTIFICATE_FILE), _load(folder / CA_FILE)
    names = _names(certificate)
    if names != [robot]:
        raise ValueError(
            f"the certificate in {folder} is of {', '.join(names)!r}, the tape is of {robot!r}: "
            f"give the folder that the dealer wrote for {robot!r}"
        )
    try:
        certificate.verify_directly_issued_by(authority)
    except (ValueError, TypeError, InvalidSignature) as error:
        raise ValueError(
            f"{folder / CERTIFICATE_FILE} was not issued by the authority in {CA_FILE} beside it: "
            "the files are of different runs of the dealer. Copy the folder again, as a whole"
        ) from error


def _load(path: Path) -> x509.Certificate:
    try:
        return x509.load_pem_x509_certificate(path.read_bytes())
    except (ValueError, OSError) as error:
        raise ValueError(f"{path} cannot be used: it is not a readable certificate") from error


def _names(certificate: x509.Certificate) -> list[str]:
    try:
        names = certificate.extensions.get_extension_for_class(x509.SubjectAlternativeName).value
    except (ValueError, x509.ExtensionNotFound):
        return []
    return [str(name.value) for name in names]
