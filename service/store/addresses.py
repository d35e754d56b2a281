"""A database's URL in words: without its password, whatever is wrong with it."""

import re

from sqlalchemy.engine import URL, make_url
from sqlalchemy.exc import ArgumentError

from service.store.errors import StoreError

_EXPECTED = "empty, sqlite:///PATH or postgresql://USER:PASSWORD@HOST/DATABASE"
_KNOWN = re.compile(r"(?:sqlite|postgres(?:ql)?|mysql|mariadb|mssql|oracle)(?:\+[a-z0-9]+)?(?!\w)")
_SECRET = re.compile("pass|pwd|secret|token", re.IGNORECASE)
_HIDDEN = "hidden"


def parse_address(text: str) -> URL:
    """Parse the configured URL of a database.

    Raises `StoreError` if it is none of the kinds that there are; one line without its password.
    """
    try:
        url = make_url(text)
    except (ArgumentError, ValueError):  # the latter for a port that is none
        raise _unusable(text) from None
    backend, driver = url.get_backend_name(), url.drivername.partition("+")[2]
    in_memory = backend == "sqlite" and (not url.database or url.database == ":memory:")
    if backend not in ("sqlite", "postgresql") or in_memory or driver not in ("", "psycopg"):
        raise _unusable(text)
    # What follows an @ in a password would be taken for the host, and shown.
    if backend == "postgresql" and any("@" in (part or "") for part in (url.host, url.database)):
        raise _unusable(text, "; an @ in the password is written %40")
    return url


def shown(url: URL) -> str:
    """Write a URL without its password, and without those among its options."""
    options = {name: _HIDDEN if _SECRET.search(name) else one for name, one in url.query.items()}
    return url.set(query=options).render_as_string(hide_password=True)


def without_secrets(text: str, url: URL) -> str:
    """Take a URL's passwords out of what a library says about it; on one line."""
    secrets = [url.password, *(one for name, one in url.query.items() if _SECRET.search(name))]
    for secret in secrets:
        if isinstance(secret, str) and secret:
            text = text.replace(secret, _HIDDEN)
    return " ".join(text.split())


def _unusable(text: str, hint: str = "") -> StoreError:
    """Name the kind of database alone: any other part may be a password in the wrong place."""
    kind = _KNOWN.match(text)
    begins = "" if kind is None else kind[0]
    return StoreError(
        f"service.database_url = '{begins}…' (the rest may hold a password): "
        f"expected {_EXPECTED}{hint}"
    )
