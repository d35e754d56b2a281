"""One module per noun. Each has a `router`; the application takes them all."""

import importlib
import pkgutil

from fastapi import APIRouter


def routers() -> dict[str, APIRouter]:
    """Every module's router by the module's name, in alphabetical order."""
    found = {}
    for name in sorted(module.name for module in pkgutil.iter_modules(__path__)):
        found[name] = importlib.import_module(f"{__name__}.{name}").router
    return found
