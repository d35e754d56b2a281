"""What can go wrong with the store."""


class StoreError(ValueError):
    """The store cannot be used as it is configured; the text is one line for the user."""


class DataDirectoryInUseError(StoreError):
    """Another service already works on this data directory."""


class DatabaseInUseError(StoreError):
    """Another service already works on this database."""


class StoreUnavailableError(RuntimeError):
    """The store is there but does not answer now (locked, disk full, I/O error); try again."""


class ActiveJobError(Exception):
    """An identification job of this asset is already queued or running.

    Parameters
    ----------
    job_id : str
        The job that is in the way.
    """

    def __init__(self, job_id: str) -> None:
        super().__init__(f"job {job_id} is already queued or running for this asset")
        self.job_id = job_id
