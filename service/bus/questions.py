"""Questions that a worker computes for a caller: not in the cell, and not in the asking process.

A question is a function with the decorator `Question`, which is all of its registration. Its first
parameter is what it is about, an `Asked` of `service.web.worker`; the others and its result are
pickled. A caller asks with ``await asset.compute(envelope)``.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Protocol, TypeVar

from service.documents.machine import PresentMachine

AnswerT = TypeVar("AnswerT")
FunctionT = TypeVar("FunctionT", bound=Callable[..., Any])


@dataclass(frozen=True, slots=True)
class Question:
    """How a question is answered.

    Attributes
    ----------
    at_once
        By the worker that is kept ready while a client follows the machines, else by the one for
        studies, which take seconds.
    of_store
        From what the store holds; else from the present state of the machine as well, and the
        caller is refused while there is none.
    needs_operation
        What needs to know the speed and load of the machine: the caller is refused while it is not
        known what it runs at.
    """

    at_once: bool = False
    of_store: bool = False
    needs_operation: str = ""

    def __call__(self, function: FunctionT) -> FunctionT:
        """Make a function a question."""
        function.__dict__["question"] = self
        return function


def how_answered(question: Callable[..., Any]) -> Question:
    """How a question is answered."""
    how: Question = question.__dict__["question"]
    return how


class Questions(Protocol):
    """Has workers answer questions."""

    async def answer(
        self,
        question: Callable[..., AnswerT],
        asset: str,
        machine: PresentMachine | None,
        *arguments: Any,
    ) -> AnswerT:
        """Have a question about an asset answered.

        Raises
        ------
        NotReadyError
            If the model version is not in the store, or the worker has died.
        """
