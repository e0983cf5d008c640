"""The mission's certificate authority, read back by an X.509 verifier of its own."""

import datetime
import os
import stat

import pytest
from cryptography import x509
from cryptography.hazmat.primitives import serialization
from cryptography.x509.oid import ExtendedKeyUsageOID, NameOID

from dealer.pki import MissionAuthority, write_credentials

UTC = datetime.timezone.utc


@pytest.fixture(scope="module")
def authority():
    return MissionAuthority("mission-7")


@pytest.fixture(scope="module")
def alice(authority):
    return authority.credentials("alice")


@pytest.fixture(scope="module")
def certificate(alice):
    return x509.load_pem_x509_certificate(alice.cert_pem)


@pytest.fixture(scope="module")
def ca(alice):
    return x509.load_pem_x509_certificate(alice.ca_pem)


def extension(certificate, kind):
    found = certificate.extensions.get_extension_for_class(kind)
    return found.value, found.critical


def test_a_robots_certificate_is_signed_by_the_authority(certificate, ca):
    certificate.verify_directly_issued_by(ca)
    ca.verify_directly_issued_by(ca)


def test_the_private_key_belongs_to_the_certificate(alice, certificate):
    key = serialization.load_pem_private_key(alice.key_pem, None)
    assert key.public_key() == certificate.public_key()


def test_the_only_name_is_the_robots(certificate):
    names, _ = extension(certificate, x509.SubjectAlternativeName)
    assert list(names) == [x509.DNSName("alice")]


def test_the_mission_is_in_every_certificate(certificate, ca):
    for each in (certificate, ca):
        assert [a.value for a in each.subject.get_attributes_for_oid(NameOID.ORGANIZATION_NAME)] == [
            "mission-7"
        ]


def test_a_robot_cannot_issue_certificates(certificate):
    assert extension(certificate, x509.BasicConstraints) == (x509.BasicConstraints(False, None), True)
    usage, critical = extension(certificate, x509.KeyUsage)
    assert critical
    assert usage.digital_signature
    assert not usage.key_cert_sign


def test_the_authority_can_issue_for_robots_only(ca):
    assert extension(ca, x509.BasicConstraints) == (x509.BasicConstraints(True, 0), True)
    usage, critical = extension(ca, x509.KeyUsage)
    assert critical
    assert usage.key_cert_sign
    assert not usage.digital_signature


def test_a_robot_may_listen_and_call(certificate):
    usage, _ = extension(certificate, x509.ExtendedKeyUsage)
    assert set(usage) == {ExtendedKeyUsageOID.SERVER_AUTH, ExtendedKeyUsageOID.CLIENT_AUTH}


def test_certificates_suit_a_robot_without_a_clock(certificate, ca):
    for each in (certificate, ca):
        assert each.not_valid_before_utc == datetime.datetime(1970, 1, 1, tzinfo=UTC)
        assert each.not_valid_after_utc == datetime.datetime(9999, 12, 31, 23, 59, 59, tzinfo=UTC)


@pytest.mark.parametrize("name", ["r", "robot_1", "Spot-2", "7", "a" * 31])
def test_usual_robot_names_are_accepted(name):
    certificate = x509.load_pem_x509_certificate(MissionAuthority().credentials(name).cert_pem)
    names, _ = extension(certificate, x509.SubjectAlternativeName)
    assert names.get_values_for_type(x509.DNSName) == [name]


@pytest.mark.parametrize(
    "name", ["", "a" * 32, "-a", "_a", "..", "a/b", "a.b", "a b", "ä", "*", "a\n", "a\0", "٣"]
)
def test_other_names_are_refused(name):
    with pytest.raises(ValueError, match="a robot's name is"):
        MissionAuthority().credentials(name)


@pytest.mark.parametrize("name", ["bob", "BOB"])
def test_a_name_is_issued_once(name):
    authority = MissionAuthority()
    authority.credentials("bob")
    with pytest.raises(ValueError, match="already"):
        authority.credentials(name)


def test_missions_differ_by_default():
    assert MissionAuthority().mission != MissionAuthority().mission


@pytest.mark.parametrize("mission", ["", "m" * 65])
def test_a_mission_id_that_does_not_fit_is_refused(mission):
    with pytest.raises(ValueError, match="1 to 64 characters"):
        MissionAuthority(mission)


def test_nobody_joins_after_the_key_is_forgotten():
    authority = MissionAuthority()
    authority.credentials("alice")
    authority.forget()
    authority.forget()
    with pytest.raises(RuntimeError, match="forgotten"):
        authority.credentials("bob")


def test_the_private_key_is_not_shown(alice):
    assert "PRIVATE" not in repr(alice)


def test_credentials_are_private_files(alice, tmp_path):
    folder = tmp_path / "mission" / "alice"
    before = os.umask(0)
    try:
        write_credentials(folder, alice)
    finally:
        os.umask(before)
    assert stat.S_IMODE(folder.stat().st_mode) == 0o700
    assert {path.name: path.read_bytes() for path in folder.iterdir()} == {
        "ca.pem": alice.ca_pem,
        "cert.pem": alice.cert_pem,
        "key.pem": alice.key_pem,
    }
    assert {stat.S_IMODE(path.stat().st_mode) for path in folder.iterdir()} == {0o600}


@pytest.mark.parametrize("taken", ["key.pem", "cert.pem", "ca.pem"])
def test_nothing_is_overwritten_or_left_behind(alice, tmp_path, taken):
    (tmp_path / taken).write_bytes(b"mine")
    with pytest.raises(FileExistsError):
        write_credentials(tmp_path, alice)
    assert {path.name: path.read_bytes() for path in tmp_path.iterdir()} == {taken: b"mine"}


def test_a_link_is_not_followed(alice, tmp_path):
    (tmp_path / "key.pem").symlink_to(tmp_path / "elsewhere")
    with pytest.raises(FileExistsError):
        write_credentials(tmp_path, alice)
    assert not (tmp_path / "elsewhere").exists()
