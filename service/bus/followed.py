"""Which assets somebody follows: of the others no live messages are made."""

import math
import time
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field

#: Wall seconds for which an asset is followed after somebody said so: who loses the connection for
#: less than that misses nothing.
FOLLOWED_FOR_S = 600.0
_ALL = None


@dataclass(slots=True)
class _Interest:
    """Until when somebody follows, and after which number all messages were made."""

    until_s: float = -math.inf
    after: int = 0


@dataclass(slots=True)
class Followed:
    """Assets that are followed, each for a while; the parameters are for tests.

    Parameters
    ----------
    lasts_s : float
        Wall seconds for which one word lasts.
    wall_s : callable
        Monotonic time.
    """

    lasts_s: float = FOLLOWED_FOR_S
    wall_s: Callable[[], float] = time.monotonic
    _interests: dict[str | None, _Interest] = field(default_factory=dict)

    def note(self, assets: Iterable[str] | None, number: int) -> int:
        """Record that a client follows some assets, or all.

        Parameters
        ----------
        assets : iterable of str, optional
            Which; all by default.
        number : int
            Of the latest message.

        Returns
        -------
        int
            Number after which there are all messages of these assets.
        """
        now_s = self.wall_s()
        self._interests = {
            name: one for name, one in self._interests.items() if one.until_s > now_s
        }
        everything = self._interests.get(_ALL)
        complete = 0
        for name in [_ALL] if assets is None else assets:
            known = self._interests.get(name)
            if known is None:
                known = _Interest(after=number if everything is None else everything.after)
                self._interests[name] = known
            elif everything is not None:
                known.after = min(known.after, everything.after)
            known.until_s = now_s + self.lasts_s
            complete = max(complete, known.after)
        return complete

    def has(self, asset: str) -> bool:
        """Whether somebody follows an asset now."""
        interests = self._interests
        if not interests:
            return False
        now_s = self.wall_s()
        return any(
            known is not None and known.until_s > now_s
            for known in (interests.get(asset), interests.get(_ALL))
        )
