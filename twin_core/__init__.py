"""The virtual model of a rolling bearing: pure computation, no I/O, no clock."""


class TwinCoreError(Exception):
    """The root of all that the model raises of its own."""
