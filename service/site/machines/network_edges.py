"""The kinds of edges of a network in the configuration."""

from typing import Annotated, Literal

from pydantic import Discriminator

from service.domain.section import Section
from service.site.machines.network_values import (
    ZERO,
    CoefficientSection,
    EdgeEnd,
    NotNegative,
    Number,
    Positive,
)
from twin_core.network import Edge, EdgeKind


def is_boundary(end: str) -> bool:
    """Whether an end of an edge is a boundary: nodes are called ``t_..._c``."""
    return not end.startswith("t_")


class _EdgeSection(Section):
    between: tuple[EdgeEnd, EdgeEnd]

    def _coefficients(self) -> tuple[CoefficientSection, ...]:
        """All fields of the kind in order; they are the coefficients of `EdgeKind`."""
        names = [name for name in type(self).model_fields if name not in ("between", "kind")]
        return tuple(getattr(self, name) for name in names)

    def edge(self, kind: str) -> Edge:
        """Return it as the network knows it; a boundary always comes second."""
        first, second = self.between
        if is_boundary(first):
            first, second = second, first
        return Edge(
            first,
            second,
            EdgeKind[kind.replace("-", "_").upper()],
            tuple(c.coefficient() for c in self._coefficients()),
        )


class ConstantEdge(_EdgeSection):
    """A constant resistance."""

    kind: Literal["constant"]
    resistance_k_w: Positive


class ContactEdge(_EdgeSection):
    """Rolling contact: R = fixed + constant + moving / sqrt(F n)."""

    kind: Literal["contact"]
    fixed_k_w: NotNegative = ZERO
    constant_k_w: NotNegative = ZERO
    moving_k_w: Positive


class ConvectiveEdge(_EdgeSection):
    """Convection: R = base / Nu, Nu = at_rest + factor n^exponent."""

    kind: Literal["convective"]
    base_k_w: Positive
    nusselt_at_rest: NotNegative
    nusselt_factor: NotNegative
    nusselt_exponent: Number


class ConvectiveReferenceEdge(_EdgeSection):
    """Convection: R = base / Nu, Nu = at_rest + (at_3000_rpm - at_rest) (n / 3000)^exponent."""

    kind: Literal["convective-reference"]
    base_k_w: Positive
    nusselt_at_rest: NotNegative
    nusselt_at_3000_rpm: Positive
    nusselt_exponent: Number


class FilmEdge(_EdgeSection):
    """A surface to the ambient: conductance at 12 K, growing with a power of the difference."""

    kind: Literal["film"]
    conductance_w_k: Positive
    exponent: Number


class ShaftSinkEdge(_EdgeSection):
    """A rotating surface: conductance = at_rest + at_6000_rpm (n / 6000)^(2/3)."""

    kind: Literal["shaft-sink"]
    at_rest_w_k: NotNegative
    at_6000_rpm_w_k: NotNegative


class SpeedPowerEdge(_EdgeSection):
    """R = resistance (n / reference)^exponent."""

    kind: Literal["speed-power"]
    resistance_k_w: Positive
    reference_rpm: Positive
    exponent: Number


EdgeSection = Annotated[
    ConstantEdge
    | ContactEdge
    | ConvectiveEdge
    | ConvectiveReferenceEdge
    | FilmEdge
    | ShaftSinkEdge
    | SpeedPowerEdge,
    Discriminator("kind"),
]
