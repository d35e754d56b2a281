"""The laws of heat of a network in the configuration, and where the heat goes."""

from typing import Annotated, Literal, Self

from pydantic import Discriminator, Field, model_validator

from service.domain.section import Section
from service.site.machines.network_values import (
    ZERO,
    CoefficientSection,
    NotNegative,
    Number,
    Positive,
    TemperatureName,
)
from twin_core.network import Coefficient, FrictionKind, HeatShare, HeatSource


class ShareSection(Section):
    """What a node gets of the heat that the shares before it have left; the last gets the rest."""

    node: TemperatureName
    of_rest: NotNegative | None = None


class _SourceSection(Section):
    shares: tuple[ShareSection, ...] = Field(min_length=1)

    @model_validator(mode="after")
    def _the_last_takes_the_rest(self) -> Self:
        for number, share in enumerate(self.shares):
            last = number == len(self.shares) - 1
            if last and share.of_rest is not None:
                raise ValueError(
                    f"shares[{number}].of_rest: the last share takes the rest; expected no of_rest"
                )
            if not last and share.of_rest is None:
                raise ValueError(
                    f"shares[{number}].of_rest: missing; expected a fraction, as only the last "
                    "share takes the rest"
                )
            if share.of_rest is not None and not share.of_rest.parameter:
                fraction = share.of_rest.factor
                if not 0.0 <= fraction <= 1.0:
                    raise ValueError(f"shares[{number}].of_rest = {fraction:g}: expected 0 to 1")
        return self

    def heat_shares(self) -> tuple[HeatShare, ...]:
        """Return the shares as the network knows them."""
        return tuple(
            HeatShare(
                share.node,
                Coefficient(1.0) if share.of_rest is None else share.of_rest.coefficient(),
            )
            for share in self.shares
        )

    def source(self, kind: FrictionKind, lubricant: str | None) -> HeatSource:
        """Return it as the network knows it; all other fields are the law's coefficients."""
        names = [
            name
            for name in type(self).model_fields
            if name not in ("shares", "kind", "lubricant_node")
        ]
        return HeatSource(
            kind,
            tuple(getattr(self, name).coefficient() for name in names),
            self.shares[0].node if lubricant is None else lubricant,
            self.heat_shares(),
        )


class LinearSource(_SourceSection):
    """Heat in W = per_rpm n + per_n F + constant, whatever the temperature."""

    kind: Literal["linear"]
    per_rpm_w: Number = ZERO
    per_n_w: Number = ZERO
    constant_w: Number = ZERO

    def heat_source(self) -> HeatSource:
        """Return it as the network knows it."""
        return self.source(FrictionKind.LINEAR, None)


class PalmgrenSource(_SourceSection):
    """Palmgren's friction, equations (1) to (4) of the paper."""

    kind: Literal["palmgren"]
    lubricant_node: TemperatureName
    f2: Positive
    pitch_diameter_mm: Positive
    static_load_rating_n: Positive
    viscosity_mm2_s: Positive
    viscosity_fall_per_k: Number
    viscosity_reference_c: Number

    def heat_source(self) -> HeatSource:
        """Return it as the network knows it."""
        return self.source(FrictionKind.PALMGREN, self.lubricant_node)


class TwoPartSource(_SourceSection):
    """The friction law of the default model: a viscous part and a load-dependent part."""

    kind: Literal["two-part"]
    lubricant_node: TemperatureName
    moment_nmm: Positive
    speed_exponent: Number
    speed_curvature: Number = ZERO
    viscosity_exponent: Number
    speed_viscosity: Number = ZERO
    load_share: NotNegative
    viscous_load_exponent: Number = ZERO
    load_exponent: Number
    running_in: NotNegative = ZERO
    running_in_revolutions: Positive = CoefficientSection(factor=1.0e6)

    def heat_source(self) -> HeatSource:
        """Return it as the network knows it."""
        return self.source(FrictionKind.TWO_PART, self.lubricant_node)


SourceSection = Annotated[
    LinearSource | PalmgrenSource | TwoPartSource,
    Discriminator("kind"),
]
