"""The environment is read as strictly as the file, and what is wrong names the variable."""

from pathlib import Path

import pytest

from service.site.configuration import SettingsError
from service.site.settings import load_settings

FILE = '[service]\nhost = "127.0.0.1"\nport = 18260\n'


def lines(folder: Path, monkeypatch: pytest.MonkeyPatch, **variables: str) -> tuple[str, ...]:
    """What is wrong with variables; without their prefix here."""
    file = folder / "site.toml"
    file.write_text(FILE)
    for name, value in variables.items():
        monkeypatch.setenv(f"BEARING_TWIN__{name}", value)
    try:
        load_settings(file)
    except SettingsError as error:
        return tuple(error.lines)
    return ()


@pytest.mark.parametrize(
    ("name", "value", "expected"),
    [
        ("SERVICE__DATA_DIR", '"var3"', ": in quotes, which an --env-file of a container leaves"),
        ("SERVICE__HOST", "'127.0.0.1'", ": in quotes, which an --env-file"),
        ("SERVICE__PORT", '"18261"', ": in quotes, which an --env-file"),
        (
            "SERVICES__PORT",
            "18261",
            ": no section 'services'; did you mean 'service' or 'sources'?",
        ),
        ("BASE_DIR", "/", ": no section 'base_dir'; expected one of "),
        ("SERVICE__PROT", "18261", ": service.prot"),
        ("SERVICE__PORT", "many", ": service.port"),
        ("SERVICE__PORT", "", ": service.port"),
        ("SERVICE__TRUSTED_PROXIES", "127.0.0.1", ': expected JSON text, such as ["127.0.0.1"]'),
        ("SERVICE__TRUSTED_PROXIES", '["here"]', ": service.trusted_proxies[0]"),
        ("ASSETS", "[{", ": expected JSON text"),
        ("SERVICE", '{"port": "many"}', ": service.port = 'many'"),
        ("SERVICE__PORT__X", "1", ": service.port"),
    ],
)
def test_a_wrong_variable_is_named(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, name: str, value: str, expected: str
) -> None:
    (line,) = lines(tmp_path, monkeypatch, **{name: value})
    assert line.startswith(f"BEARING_TWIN__{name}{expected}"), line
    assert "var3" not in line


def test_a_wrong_variable_is_named_in_its_own_case(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("bearing_twin__service__port", "many")
    (line,) = lines(tmp_path, monkeypatch)
    assert line.startswith("bearing_twin__service__port: service.port = 'many'")


def test_right_variables_are_taken_in_whatever_case(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("bearing_twin__service__port", "18262")
    monkeypatch.setenv("BEARING_TWIN_SERVICE_PORT", "tcp://10.0.0.7:8080")
    monkeypatch.setenv("BEARING_TWIN__SERVICE__TRUSTED_PROXIES", '["127.0.0.1"]')
    file = tmp_path / "site.toml"
    file.write_text(FILE)
    service = load_settings(file).service
    assert (service.port, service.trusted_proxies) == (18262, ("127.0.0.1",))


def test_what_the_file_has_wrong_names_the_file(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("BEARING_TWIN__SERVICE__PORT", "18262")
    file = tmp_path / "site.toml"
    file.write_text("[service]\nhost = 3\n")
    with pytest.raises(SettingsError) as error:
        load_settings(file)
    assert error.value.lines[0].startswith(f"{file}: service.host")


@pytest.mark.parametrize(
    ("raw", "expected"),
    [
        (FILE.encode("utf-8-sig"), ""),
        (FILE.encode("utf-16"), "in UTF-16; expected a file in UTF-8"),
        (
            f"# one\n# K\u00e4ltepr\u00fcfstand\n{FILE}".encode("latin-1"),
            "line 2: byte 0xe4 is not UTF-8; expected a file in UTF-8",
        ),
    ],
)
def test_a_configuration_is_in_utf_8_with_or_without_a_mark(
    tmp_path: Path, raw: bytes, expected: str
) -> None:
    file = tmp_path / "site.toml"
    file.write_bytes(raw)
    if not expected:
        assert load_settings(file).service.port == 18260
        return
    with pytest.raises(SettingsError) as error:
        load_settings(file)
    assert error.value.lines == (f"{file}: {expected}",)
