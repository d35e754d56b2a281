"""Heats of single nodes in the configuration: of a current, of a measured power, of the speed."""

from typing import Annotated, Literal

from pydantic import Discriminator, Field, PositiveFloat

from service.domain.section import Section
from service.site.machines.network_values import (
    CoefficientSection,
    InputName,
    NotNegative,
    Number,
    Positive,
    TemperatureName,
)
from twin_core.network import Coefficient, Edge, EdgeKind

COPPER_PER_K = 0.00393


class CopperLoss(Section):
    """Heat of a current I: W = R20 (1 + alpha (T - 20)) I^2, with T of its node."""

    node: TemperatureName
    kind: Literal["copper"]
    channel: InputName
    resistance_20_ohm: Positive
    alpha_per_k: float = Field(COPPER_PER_K, ge=0.0, le=0.05)

    def edge(self) -> Edge:
        """Return it as the network knows it."""
        coefficients = (self.resistance_20_ohm.coefficient(), Coefficient(self.alpha_per_k))
        return Edge(self.node, self.channel, EdgeKind.COPPER, coefficients)


class PowerLoss(Section):
    """Heat that is measured, or that a channel drives: W = factor ref (P / ref)^exponent."""

    node: TemperatureName
    kind: Literal["power"]
    channel: InputName
    factor: NotNegative = CoefficientSection(factor=1.0)
    reference: PositiveFloat = 1.0
    exponent: Number = CoefficientSection(factor=1.0)

    def edge(self) -> Edge:
        """Return it as the network knows it."""
        coefficients = (
            self.factor.coefficient(),
            Coefficient(self.reference),
            self.exponent.coefficient(),
        )
        return Edge(self.node, self.channel, EdgeKind.POWER, coefficients)


class SpeedLoss(Section):
    """Heat of iron and windage: W = loss (n / reference)^exponent."""

    node: TemperatureName
    kind: Literal["speed"]
    loss_w: NotNegative
    reference_rpm: PositiveFloat
    exponent: Number

    @property
    def channel(self) -> str:
        """The speed drives it, which is no channel of its own."""
        return ""

    def edge(self) -> Edge:
        """Return it as the network knows it."""
        coefficients = (
            self.loss_w.coefficient(),
            Coefficient(self.reference_rpm),
            self.exponent.coefficient(),
        )
        return Edge(self.node, "", EdgeKind.SPEED_LOSS, coefficients)


LossSection = Annotated[CopperLoss | PowerLoss | SpeedLoss, Discriminator("kind")]
