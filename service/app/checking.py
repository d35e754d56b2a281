"""What a configuration needs of the machine: certificates, extras, databases, free ports."""

import socket

from service.feature_folders import modules
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


def ports_in_use(settings: Settings) -> list[str]:
    """Name the ports of the configuration that another program listens on, one line each."""
    from service.plant.publishers import endpoints

    section = settings.service
    places = {f"service.port = {section.port}": (section.host, section.port)}
    places |= {one.key: (one.host, one.port) for one in endpoints(settings)}
    return [
        f"{key}: cannot listen there ({why}); expected a free port, or this service runs already"
        for key, (host, port) in places.items()
        if (why := _why_not_bound(host, port))
    ]


def _why_not_bound(host: str, port: int) -> str:
    with socket.socket(socket.AF_INET6 if ":" in host else socket.AF_INET) as probe:
        probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            probe.bind((host, port))
        except OSError as error:
            return error.strerror or str(error)
    return ""
