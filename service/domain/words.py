"""How figures are said in texts that people read; the page says them in the same words."""


def percent(probability: float) -> str:
    """Give a probability in whole percent, and never as 0 % or 100 %."""
    if probability < 0.005:
        return "< 1 %"
    return "> 99 %" if probability >= 0.995 else f"{100 * probability:.0f} %"
