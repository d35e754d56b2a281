"""Features: each folder of `service.features` is one, and brings what its modules are named after.

The core finds them here and names none of them. A folder may have these modules, each loaded only
where it is needed:

=============  =============================================================================
``tables``     Tables and the part of the store that works on them (`service.store.part`);
               ``CHANGES``, what outboxes carry to it (`service.store.changes`), ``OUTBOXES``, files
               of outboxes of its part of the cell
``part``       ``part(core)``, which makes its `service.tasks.Part` of the cell's `Core`
``routes``     ``router``, its REST answers; ``BODIES`` and ``WEBHOOKS``, what no signature of a
               route shows; ``UPLOADS``, how long bodies may be and of which other types than JSON
``what_ifs``   ``check``, ``question`` and ``keep``, which keep a what-if forecast that a user has
               kept (`service.web.api.routes.forecasts`)
``commands``   ``register``, which adds its commands to the command line
``health``     ``warnings``, what `bearing-twin check` warns of
``settings``   ``Sections``, a model whose fields are its tables of the configuration, and
               ``check``, which raises `SettingsError` where the machine lacks what they name
=============  =============================================================================

Its other modules, such as documents or questions to a worker, are its own. Its views still stand
in the page.
"""

from collections.abc import Iterator
from functools import cache
from importlib import import_module
from importlib.resources import files
from importlib.util import find_spec
from pathlib import Path
from types import ModuleType
from typing import Any, Final

_FOLDER: Final = "service.features"


@cache
def feature_names() -> tuple[str, ...]:
    """Names of all features, in alphabetical order."""
    folders = (place for place in files(_FOLDER).iterdir() if place.is_dir())
    return tuple(sorted(one.name for one in folders if (one / "__init__.py").is_file()))


def feature_paths(folder: str) -> list[Path]:
    """Give a folder of each feature that has it."""
    places = (Path(str(files(_FOLDER) / name / folder)) for name in feature_names())
    return [place for place in places if place.is_dir()]


def modules(module: str) -> Iterator[tuple[str, ModuleType]]:
    """Load one module of each feature that has it, with the feature's name before it."""
    for feature in feature_names():
        name = f"{_FOLDER}.{feature}.{module}"
        if find_spec(name) is not None:
            yield feature, import_module(name)


def declared(module: str, name: str) -> Iterator[Any]:
    """Give what the features list under one name in one of their modules."""
    for _, feature in modules(module):
        yield from getattr(feature, name, ())
