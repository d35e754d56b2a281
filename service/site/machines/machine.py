"""The machine of an asset or of a model file, and the model that is built of it."""

import functools
import json
from dataclasses import dataclass
from typing import Final, Self, TypedDict

from service.site.machines.bearings import BearingSection
from service.site.machines.networks import NetworkSection
from twin_core.models import ThermalModel, build_model

#: Different machines whose models are kept.
KEPT_MACHINES: Final = 256


class MachineParts(TypedDict):
    """What a machine is built of, as plain JSON types; see `Machine.to_dict`."""

    model: str
    bearing: dict[str, object] | None
    network: dict[str, object] | None


@dataclass(frozen=True, slots=True)
class Machine:
    """A bearing in the network that comes with the product, or a network of the user's own.

    - ``model_name``: one of `service.site.settings.ModelName`; not used by a network of one's own.
    - ``bearing``: None only with a network.
    - ``network``: None for `BEARING_14`.
    """

    model_name: str
    bearing: BearingSection | None
    network: NetworkSection | None

    @property
    def name(self) -> str:
        """The bearing's designation, or the name of the network."""
        part = self.network or self.bearing
        return "" if part is None else part.name

    @property
    def temperature_names(self) -> tuple[str, ...] | None:
        """What may be measured on a network of one's own; None for the network of a bearing."""
        return None if self.network is None else self.network.temperature_names

    @property
    def inputs(self) -> tuple[str, ...]:
        """Channels that a network of one's own asks for besides speed, load and ambient."""
        return () if self.network is None else self.network.inputs

    @property
    def mean_square(self) -> tuple[str, ...]:
        """Those of the inputs whose square is heat: currents."""
        return () if self.network is None else self.network.mean_square_inputs

    def build(self) -> ThermalModel:
        """Build the model, compiled.

        Raises `ValueError` if there is neither a network nor a bearing.
        """
        if self.network is None:
            if self.bearing is None:
                raise ValueError("bearing: missing; expected a bearing or a network")
            return build_model(self.model_name, bearing=self.bearing.bearing())
        section = self.network
        return ThermalModel(
            section.name,
            section.network(),
            section.parameter_set(),
            section.compiled(),
            section.name,
            errors=section.error_model(),
            reference_point=(section.reference.speed_rpm, section.reference.load_n),
            reference_inputs=tuple(section.reference.inputs.get(n, 0.0) for n in section.inputs),
            runaway=section.runaway_limits(),
        )

    def to_dict(self) -> MachineParts:
        """Return plain JSON types, all that `from_dict` needs."""
        return {
            "model": self.model_name,
            "bearing": None if self.bearing is None else self.bearing.model_dump(mode="json"),
            "network": None if self.network is None else self.network.model_dump(mode="json"),
        }

    @classmethod
    def from_dict(cls, document: MachineParts) -> Self:
        """Take back what `to_dict` gave. Raises `ValueError` if it is not such a document."""
        bearing, network = document["bearing"], document["network"]
        return cls(
            str(document["model"]),
            None if bearing is None else BearingSection.model_validate(bearing),
            None if network is None else NetworkSection.model_validate(network),
        )


def why_no_sister(machine: Machine, family: str, other: Machine, other_family: str) -> str:
    """Say why another machine is no sister of a machine; empty if it may be one."""
    if (machine.network is None) != (other.network is None) or machine.name != other.name:
        return f"{_kind(other)} {other.name!r}, expected {_kind(machine)} {machine.name!r}"
    if machine.network != other.network:
        return f"network {other.name!r} differs from the one of the same name that is expected"
    if machine.network is None and machine.model_name != other.model_name:
        return f"model {other.model_name!r}, expected {machine.model_name!r}"
    if machine.bearing != other.bearing:
        return f"bearing {other.name!r} has other dimensions than the one that is expected"
    if family and other_family and family != other_family:
        return f"family {other_family!r}, expected {family!r}"
    return ""


def _kind(machine: Machine) -> str:
    return "bearing" if machine.network is None else "network"


def shared_model(machine: Machine) -> ThermalModel:
    """Give the model of a machine, as `Machine.build`; equal machines share one."""
    return model_of_parts(json.dumps(machine.to_dict()))


# In a fleet thousands of assets are one machine.
@functools.lru_cache(KEPT_MACHINES)
def model_of_parts(parts: str) -> ThermalModel:
    """Give the model of what `Machine.to_dict` gave, as JSON text."""
    return Machine.from_dict(json.loads(parts)).build()
