"""What all parts of the store share."""

from service.store.database import Database


class Section:
    """One part of the store: the methods that belong to one noun, on a shared database.

    All methods are synchronous and may be called from any thread; callers on an event loop go
    through a worker thread. A method raises `StoreUnavailableError` when the database does not
    answer.
    """

    def __init__(self, database: Database) -> None:
        self._database = database
