"""Files of lists that commands read and write: what they are follows from their names."""

from pathlib import Path

from service.site.configuration import SettingsError


def is_csv(file: Path) -> bool:
    """Whether a list is CSV; else it is JSON.

    Raises `SettingsError` if the name ends in neither.
    """
    suffix = file.suffix.lower()
    if suffix not in (".csv", ".json"):
        raise SettingsError(f"{file}: expected a name that ends in .csv or .json")
    return suffix == ".csv"
