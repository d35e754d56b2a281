from pathlib import Path

import pytest
import trustme
from cryptography.hazmat.primitives import serialization as pem

from service.security.tls import tls_context
from service.site.configuration import SettingsError


@pytest.fixture(scope="module")
def issued() -> trustme.LeafCert:
    return trustme.CA().issue_cert("bench.example")


@pytest.fixture
def files(tmp_path: Path, issued: trustme.LeafCert) -> tuple[Path, Path]:
    certificate, key = tmp_path / "server.pem", tmp_path / "server.key"
    issued.cert_chain_pems[0].write_to_path(certificate)
    issued.private_key_pem.write_to_path(key)
    return certificate, key


def test_a_certificate_and_its_key(files: tuple[Path, Path]) -> None:
    assert tls_context(*files).cert_store_stats() is not None


@pytest.mark.parametrize(("missing", "name"), [(0, "tls.certificate"), (1, "tls.key")])
def test_a_file_that_is_missing_is_named(files: tuple[Path, Path], missing: int, name: str) -> None:
    files[missing].unlink()
    with pytest.raises(SettingsError, match=f"^{name} = .*No such file"):
        tls_context(*files)


@pytest.mark.parametrize("text", ["", "no certificate"])
def test_a_file_that_is_no_certificate(files: tuple[Path, Path], text: str) -> None:
    files[0].write_text(text)
    with pytest.raises(SettingsError, match="expected a PEM certificate and its private key"):
        tls_context(*files)


def test_a_key_of_another_certificate(files: tuple[Path, Path]) -> None:
    trustme.CA().issue_cert("bench.example").private_key_pem.write_to_path(files[1])
    with pytest.raises(SettingsError, match="expected a PEM certificate and its private key"):
        tls_context(*files)


def test_a_key_with_a_password_is_refused_and_asks_nobody(
    files: tuple[Path, Path], issued: trustme.LeafCert
) -> None:
    key = pem.load_pem_private_key(issued.private_key_pem.bytes(), None)
    files[1].write_bytes(
        key.private_bytes(
            pem.Encoding.PEM, pem.PrivateFormat.PKCS8, pem.BestAvailableEncryption(b"secret")
        )
    )
    with pytest.raises(SettingsError, match="needs a password"):
        tls_context(*files)


def test_a_key_that_others_may_read_is_told(
    files: tuple[Path, Path], capsys: pytest.CaptureFixture[str]
) -> None:
    for mode, told in ((0o600, False), (0o640, False), (0o644, True)):
        files[1].chmod(mode)
        tls_context(*files)
        output = capsys.readouterr().out
        assert ("tls_key_readable_by_others" in output) is told
        assert (str(files[1]) in output) is told
