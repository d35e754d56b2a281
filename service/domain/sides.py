"""The sides of a service, each a process of its own."""

from typing import Literal

SideName = Literal["cell", "web", "plant"]
