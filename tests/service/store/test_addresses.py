"""No password of a database's URL stands in an error, however the URL is wrong."""

import traceback
from pathlib import Path

import pytest

from service.store import Store, StoreError
from service.store.addresses import parse_address, shown

SECRET = "S3cr3tW0rd"

#: What people write; each holds the password somewhere.
MALFORMED = [
    f"postgresql//u:{SECRET}@h/d",
    f"postgresql:/u:{SECRET}@h/d",
    f"postgresql:u:{SECRET}@h/d",
    f"postgresql ://u:{SECRET}@h/d",
    f" postgresql://u:{SECRET}@h/d",
    f"postgresql;//u:{SECRET}@h/d",
    f"postgresql:\\\\u:{SECRET}@h\\d",
    f"postgresql+asyncpg://u:{SECRET}@h/d",
    f"postgresql+psycopg2://u:{SECRET}@h/d",
    f"postgres://u:{SECRET}@h/d",
    f"POSTGRESQL://u:{SECRET}@h/d",
    f"postgresql://u:{SECRET}@h:54a32/d",
    f"postgresql://u:{SECRET}",
    f"postgresql://h:{SECRET}/d",
    f"postgresql://u:x@{SECRET}@h/d",
    f"postgresql://u:x/@{SECRET}@h/d",
    f"postgresql://u:x@h@{SECRET}/d",
    f"postgresql://u:{SECRET}@[::1/d",
    f"//u:{SECRET}@h/d",
    f"u:{SECRET}@h/d",
    f"u:{SECRET}",
    SECRET,
    f"{SECRET}://h/d",
    f"host=h dbname=d user=u password={SECRET}",
    f"jdbc:postgresql://h/d?user=u&password={SECRET}",
    f"mysql://u:{SECRET}@h/d",
    f"mysql://h/d?password={SECRET}",
    f"mssql+pyodbc:///?odbc_connect=PWD%3D{SECRET}",
    f"sqlite://u:{SECRET}@h/:memory:",
    f"sqlite:/{SECRET}@",
    f"sqlite+{SECRET}:///x.db",
    f"https://u:{SECRET}@h/d",
    f"'postgresql://u:{SECRET}@h/d'",
    f"postgresql://u:{SECRET}@127.0.0.1:1/d",
    f"postgresql://127.0.0.1:1/d?user=u&password={SECRET}",
    f"postgresql://u@127.0.0.1:1/d?sslpassword={SECRET}&sslmode=wrong",
    f"postgresql://u@127.0.0.1:1/d?connect_timeout=1&password={SECRET}&password=b",
]


@pytest.mark.parametrize("url", MALFORMED)
def test_an_error_names_the_key_and_never_the_password(tmp_path: Path, url: str) -> None:
    with pytest.raises(StoreError, match=r"^service\.database_url = ") as caught:
        Store.open(url, tmp_path)
    assert "\n" not in str(caught.value)
    assert SECRET.lower() not in str(caught.value).lower()
    # Nor would a log that takes the causes along.
    assert (
        SECRET.lower()
        not in "".join(
            line
            for line in traceback.format_exception(caught.value)
            if not line.lstrip().startswith("File")
        ).lower()
    )


def test_what_can_be_shown_is_shown() -> None:
    url = parse_address(f"postgresql://u:{SECRET}@h:5433/d?sslmode=require&password={SECRET}")
    assert shown(url) == "postgresql://u:***@h:5433/d?password=hidden&sslmode=require"
    assert url.password == SECRET
    with pytest.raises(StoreError, match=r"'postgresql…'.*an @ in the password is written %40"):
        parse_address("postgresql://u:p@ss@h/d")
    assert parse_address("postgresql://u:p%40ss@h/d").password == "p@ss"
