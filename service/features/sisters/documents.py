"""What sisters of a machine can teach it."""

from pydantic import Field

from service.documents.base import Document, Time


class SisterLine(Document):
    """What one machine of the family can teach."""

    asset: str
    machine: str = Field(description="Its bearing or network.", examples=["6016"])
    load_n_max: float = Field(description="Heaviest load that it has seen, N.")
    speed_rpm_max: float = Field(description="Highest speed that it has seen, rpm.")
    minutes: int = Field(ge=0, description="Minutes of operation behind it.")
    until: Time = Field(description="End of these data.")


class SisterList(Document):
    """The other machines of an asset's family that have something to teach, the farthest first."""

    family: str | None = Field(description="Null: the asset belongs to no family.")
    items: list[SisterLine]
