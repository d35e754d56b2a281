"""What a configuration needs of the machine: certificates, extras, databases, free ports."""

import tempfile

from service.domain.errors import TemporaryError
from service.feature_folders import modules
from service.plant.endpoints import check_endpoint
from service.site.configuration import SettingsError
from service.site.settings import Settings
from service.worker_pools import why_no_worker


def environment_errors(settings: Settings) -> list[str]:
    """Say what the machine lacks that the configuration asks for, one line each."""
    # Imported here: most configurations need it not, and it loads much.
    from service.store import StoreError
    from service.store.opening import database_address

    errors: list[str] = []
    try:
        database_address(settings.service.database_url, settings.data_dir)
    except StoreError as error:
        errors.append(f"service.database_url: {error}")
    if settings.tls is not None:
        from service.security.tls import tls_context

        tls = settings.tls
        try:
            tls_context(settings.path(tls.certificate), settings.path(tls.key))
        except SettingsError as error:
            errors += error.lines
    from service.plant.publishers import check_extras

    for check in (check_extras, *(feature.check for _, feature in modules("settings"))):
        try:
            check(settings)
        except SettingsError as error:
            errors += error.lines
    if settings.is_fleet:
        errors += _fleet_errors(settings)
    return errors


def machine_warnings() -> list[str]:
    """Say what a service does without on this machine, one line each."""
    why = why_no_worker()
    return [] if why is None else [f"no identification and no what-if forecast: {why}"]


def _fleet_errors(settings: Settings) -> list[str]:
    """Say what the cells of a fleet would not find, one line each."""
    from service.bus.fleet_connection import connection_problem
    from service.store import Store, StoreError

    errors = []
    try:
        Store.open(settings.service.database_url, settings.data_dir).close()
    except StoreError as error:
        errors.append(str(error))
    problem = connection_problem(settings)
    return errors if problem is None else [*errors, problem]


def place_problems(settings: Settings) -> tuple[list[str], list[str]]:
    """Try the data directory and the ports of a configuration; nothing is left there.

    Returns what a start would refuse, and what it would wait for or may find otherwise: a port of a
    service that runs, a directory that this user cannot write.
    """
    from service.plant.publishers import endpoints, own_endpoint

    errors: list[str] = []
    warnings: list[str] = []
    for endpoint in (own_endpoint(settings), *endpoints(settings)):
        try:
            check_endpoint(endpoint)
        except TemporaryError as error:
            warnings.append(f"{error}, or this service runs already")
        except SettingsError as error:
            # Another user may be allowed to.
            here = isinstance(error.__cause__, PermissionError)
            (warnings if here else errors).extend(error.lines)
    data_dir = settings.data_dir
    there = data_dir
    try:
        there = next(one for one in (data_dir, *data_dir.resolve().parents) if one.exists())
        with tempfile.TemporaryFile(dir=there):
            pass
    except PermissionError as error:
        warnings.append(f"data directory {data_dir}: not by this user ({there}: {error.strerror})")
    except OSError as error:
        errors.append(f"data directory {data_dir}: cannot be used ({there}: {error.strerror})")
    return errors, warnings
