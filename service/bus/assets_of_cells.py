"""Which cell of a fleet follows which asset, as the cells say."""

import zlib
from collections.abc import Callable, Collection, Mapping


class AssetsOfCells:
    """The assets of every cell; of two cells that claim one, the cell that said so later has it.

    - ``known``: gives the ids of all assets of the fleet, in any cell.
    - ``numbers``: of every asset the number of its object; another one in another cell.
    - ``revision``: grows whenever they change.
    """

    def __init__(self, known: Callable[[], Collection[str]]) -> None:
        self.known = known
        self.numbers: dict[str, int] = {}
        self.revision = 0
        # By cell, and of which state of it that is known.
        self._names: dict[str, Mapping[str, int]] = {}
        self._states: dict[str, tuple[int, int]] = {}
        # Cells that claim an asset, the one that has it last.
        self._claims: dict[str, list[str]] = {}

    def state_of(self, token: str) -> tuple[int, int] | None:
        """Of which state of a cell its assets are known; None before they are."""
        return self._states.get(token)

    def claims(self, asset: str) -> list[str]:
        """Cells that claim an asset, the one that has it first."""
        return self._claims.get(asset, [])[::-1]

    def of_cell(self, token: str, assets: Collection[str] | None) -> Collection[str] | None:
        """Those of some assets that a cell follows; None for all."""
        if assets is None:
            return None
        names = self._names.get(token, {})
        return [name for name in assets if name in names]

    def learn(self, token: str, names: Mapping[str, int], state: tuple[int, int]) -> None:
        """Record which assets a cell follows; `count` comes after."""
        # Last in order: of two that claim an asset, the one that said so later has it.
        self._names.pop(token, None)
        self._names[token], self._states[token] = names, state

    def forget(self, token: str) -> None:
        """Drop a cell; `count` comes after."""
        self._names.pop(token, None)
        self._states.pop(token, None)

    def count(self, replaced: Collection[str]) -> None:
        """Find who follows what; ``replaced``: cells whose partitions others have taken over."""
        claims: dict[str, list[str]] = {}
        found: dict[str, int] = {}
        for token in sorted(self._names, key=lambda one: one not in replaced):
            for name, number in self._names[token].items():
                claims.setdefault(name, []).append(token)
                # Of another cell it is another object, whatever its number there.
                found[name] = zlib.crc32(f"{token} {number}".encode())
        known = {name: place for place, name in enumerate(self.known())}
        # An asset without a cell at the moment stays as it was: its cell is being replaced.
        everything = {name: number for name, number in self.numbers.items() if name in known}
        everything |= found
        ordered = sorted(everything, key=lambda name: (known.get(name, len(known)), name))
        self._claims = claims
        numbers = {name: everything[name] for name in ordered}
        if numbers != self.numbers:
            self.numbers = numbers
            self.revision += 1
