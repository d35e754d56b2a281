"""What the service refuses."""

import httpx2
from pydantic import ValidationError

from bearing_twin_client.documents import ProblemDocument


class ProblemError(Exception):
    """A call that the service refused or could not answer, as RFC 9457 has it.

    `title` is the HTTP status in words, `detail` one line, `field` the first field that is wrong: a
    JSON pointer into the body, or the name of a parameter. `problem` is the whole document; None
    where something between here and the service answered.
    """

    def __init__(self, answer: httpx2.Response) -> None:
        self.status = answer.status_code
        self.field: str | None = None
        self.problem: ProblemDocument | None = None
        try:
            self.problem = ProblemDocument.model_validate_json(answer.content)
        except ValidationError:
            self.title, self.detail = answer.reason_phrase, answer.text[:300]
        else:
            self.title, self.detail = self.problem.title, self.problem.detail
            for error in self.problem.errors or []:
                self.field = self.field or error.pointer or error.parameter
        super().__init__(f"{self.status} {self.title}: {self.detail}")
