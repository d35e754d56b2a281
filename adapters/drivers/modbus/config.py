"""Configuration models of the Modbus driver."""

from typing import Annotated, Literal, Self

from pydantic import BeforeValidator, Field, field_validator, model_validator

from adapters.configuration import MeasuredChannel, SourceConfig, StrictModel

Kind = Literal["input", "holding", "coil", "discrete"]
ValueType = Literal["int16", "uint16", "int32", "uint32", "float32", "float64", "bool"]
Order = Literal["big", "little"]
LAST_REGISTER = 65535
# Where the numbers of data sheets begin, which hold the kind in their first digit; five and six
# digits are both in use.
DATA_SHEET_FIRST: dict[int, Kind] = {
    400001: "holding", 300001: "input", 100001: "discrete",
    40001: "holding", 30001: "input", 10001: "discrete",
}  # fmt: skip


def data_sheet_hint(address: int, kind: Kind | None = None) -> str:
    """Say what a number of a data sheet is on the wire; empty when it is none."""
    for first, table in DATA_SHEET_FIRST.items():
        most = 65536 if first > LAST_REGISTER else 9999
        if first <= address < first + most:
            other = "" if table == kind else f', kind = "{table}"'
            return f"data sheets count from {first}: try register = {address - first}{other}"
    return ""


def _on_the_wire(address: object) -> object:
    hint = data_sheet_hint(address) if isinstance(address, int) and address > LAST_REGISTER else ""
    if hint:
        raise ValueError(f"expected 0 to {LAST_REGISTER}, as on the wire; {hint}")
    return address


Register = Annotated[int, BeforeValidator(_on_the_wire), Field(ge=0, le=LAST_REGISTER)]
Unit = Annotated[int, Field(ge=0, le=255)]

BIT_KINDS = ("coil", "discrete")
REGISTERS_PER_READ = 125  # of one request, by the Modbus specification
BITS_PER_REGISTER = 16  # also of the longest requests: 2000 bits
PLAN_ROW_REGISTERS = 6


PollIntervalS = Annotated[float, Field(ge=0.01)]


class PolledSource(SourceConfig):
    """What is polled: how often, and what the device bears.

    `poll_interval_s` is process time; a channel may have its own. `request_gap_s` (from an answer
    to the next request) and `connect_pause_s` (from the connection to the first request) are wall
    time. `register_gap_max` is the number of unasked-for addresses between two wanted ones that
    one request may read across; without it 8 registers or 64 bits.
    """

    poll_interval_s: PollIntervalS = 1.0
    registers_per_read_max: int = Field(default=REGISTERS_PER_READ, ge=1, le=REGISTERS_PER_READ)
    register_gap_max: int | None = Field(default=None, ge=0, le=REGISTERS_PER_READ)
    request_gap_s: float = Field(default=0.0, ge=0.0, le=10.0)
    connect_pause_s: float = Field(default=0.0, ge=0.0, le=60.0)

    @property
    def expected_period_s(self) -> float:
        """The poll interval."""
        return self.poll_interval_s


class ModbusTcpSource(PolledSource):
    """A Modbus TCP server: a device, or a gateway with several units behind it.

    `timeout_s` (connecting and answering) is wall time. `framing = "rtu"` is for converters that
    send the frames of a serial line, checksum included, through a TCP connection.
    """

    driver: Literal["modbus-tcp"] = "modbus-tcp"
    host: str = Field(min_length=1)
    port: int = Field(default=502, ge=1, le=65535)
    unit: Unit = 1
    timeout_s: float = Field(default=1.0, ge=0.05, le=60.0)
    framing: Literal["tcp", "rtu"] = "tcp"

    @property
    def where(self) -> str:
        """How messages name the server."""
        return f"{self.host}:{self.port}"

    @property
    def has_second_connection(self) -> bool:
        """Whether a silent unit may be tried over a connection of its own.

        Two connections would not keep the gaps between the requests, nor share a serial line.
        """
        return self.framing == "tcp" and not self.request_gap_s


class ModbusRtuSource(PolledSource):
    """A serial line (RS-485 or RS-232) with one or more units on it.

    `device` is a serial port of the operating system. `timeout_s` is the wall time given to an
    answer; a silent unit costs the others that much whenever it is tried again, since a serial
    line carries one request at a time.
    """

    driver: Literal["modbus-rtu"] = "modbus-rtu"
    device: str = Field(min_length=1)
    baudrate: int = Field(default=19200, ge=300, le=4_000_000)
    bytesize: Literal[7, 8] = 8
    parity: Literal["N", "E", "O"] = "E"
    stopbits: Literal[1, 2] = 1
    unit: Unit = 1
    timeout_s: float = Field(default=0.5, ge=0.05, le=60.0)

    @property
    def where(self) -> str:
        """How messages name the line."""
        return self.device

    @property
    def has_second_connection(self) -> bool:
        """A serial line has none."""
        return False


ModbusSource = ModbusTcpSource | ModbusRtuSource


class ModbusStatus(StrictModel):
    """A status word next to a channel: any of the named bits set makes the channel bad.

    `kind` defaults to the channel's. For coils and discrete inputs, bit n is address register + n.
    """

    address: Register = Field(alias="register")
    kind: Kind | None = None
    bits: dict[Annotated[int, Field(ge=0, le=15)], str] = Field(min_length=1)


class ModbusChannel(MeasuredChannel):
    """Where a channel is found and what its raw value means.

    value = raw * scale + offset, then the conversion. `register` counts from 0, as on the wire.
    `word_order = "little"` means that the low word comes first (CDAB), `byte_order = "little"`
    that the bytes within each register are swapped. `sentinels` are raw values, as decoded, that
    mean "no value". `poll_interval_s` is process time; without it that of the source.
    """

    address: Register = Field(alias="register")
    kind: Kind = "holding"
    type: ValueType = "int16"
    word_order: Order = "big"
    byte_order: Order = "big"
    scale: float = 1.0
    offset: float = 0.0
    unit_id: Unit | None = None
    sentinels: tuple[float, ...] = ()
    conversion: Literal["pt100_ohm"] | None = None
    status: ModbusStatus | None = None
    poll_interval_s: PollIntervalS | None = None

    @property
    def expected_period_s(self) -> float | None:
        """Its own poll interval, where it has one."""
        return self.poll_interval_s

    @property
    def resolution(self) -> float:
        """The scale of whole numbers; a floating-point register has steps too fine to see."""
        return abs(self.scale) if self.type.endswith(("int16", "int32")) else 0.0

    @model_validator(mode="before")
    @classmethod
    def _bits_are_bool(cls, data: object) -> object:
        if isinstance(data, dict) and data.get("kind") in BIT_KINDS:
            return {"type": "bool", **data}
        return data

    @field_validator("scale")
    @classmethod
    def _scale_is_not_zero(cls, scale: float) -> float:
        if scale == 0.0:
            raise ValueError("scale must not be 0")
        return scale

    @model_validator(mode="after")
    def _type_fits_kind(self) -> Self:
        if (self.kind in BIT_KINDS) != (self.type == "bool"):
            raise ValueError(
                f"type {self.type!r} does not fit kind {self.kind!r}: "
                "coil and discrete carry bool, input and holding the other types"
            )
        return self


class ModbusPlan(StrictModel):
    """The controller's planned profile: rows of uint32 duration_s, float32 speed, float32 load."""

    source: str
    address: Register = Field(alias="register")
    rows: int = Field(ge=1, le=200)
    kind: Literal["holding", "input"] = "holding"
    unit_id: Unit | None = None
    word_order: Order = "big"
