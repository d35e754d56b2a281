"""What a worker computes: the advice."""

from service.bus.questions import Question
from service.features.advice.documents import AdviceDocument
from service.web.worker import Asked


@Question()
def advice(
    asked: Asked, speed_rpm: float, load_n: float, duration_s: float, half_width_k: float | None
) -> AdviceDocument:
    """Rank low-risk steps by what they teach about a point.

    Raises `NotIdentifiedError` while the active model is not identified.
    """
    # Only the worker loads the numerics.
    from service.features.advice.advising import give_advice
    from twin_core.profiles import Step

    section, target = asked.section, Step(speed_rpm, load_n, duration_s)
    return give_advice(section, asked.state, list(section.channels), target, half_width_k)
