"""A place for a log that takes nothing."""

import contextlib
import os


class Unread:
    """Standard error that takes nothing, until it is read."""

    def __init__(self, kind: str) -> None:
        if kind == "terminal":
            self.far, self.near = os.openpty()
        else:
            self.far, self.near = os.pipe()
        os.set_blocking(self.near, False)
        with contextlib.suppress(BlockingIOError):
            while True:
                os.write(self.near, b"x" * 64)
        os.set_blocking(self.near, True)

    def read_all(self) -> str:
        os.close(self.near)
        text = b""
        with contextlib.suppress(OSError):  # a terminal whose other end is gone
            while part := os.read(self.far, 65536):
                text += part
        return text.decode()
