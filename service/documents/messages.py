"""Every kind of message of the live stream, and the schema of each."""

from typing import Literal, get_args

from pydantic import Field
from pydantic.json_schema import JsonSchemaValue, models_json_schema

from service.documents.alarms import AlarmDocument
from service.documents.assets import StateMessage
from service.documents.base import Document, Number, Time
from service.documents.forecasts import LiveForecast
from service.documents.identification import JobDocument
from service.documents.measurements import SampleItem
from service.documents.tags import Snapshot
from service.documents.verdicts import VerdictDocument

MessageType = Literal[
    "measurement", "state", "verdict", "forecast", "alarm", "job", "health", "heartbeat"
]
"""What a message may be, but for `hello`, which begins every stream."""

LIVE = (
    "Assets to follow, comma-separated, empty for none: `hello`, `measurement`, `state`, `verdict` "
    "and `forecast` come of these alone. Absent: all of `assets`."
)
"""What the parameter ``live`` of the stream means."""


# ---------------------------------------------------------------------------- what they carry
class NewSamples(Document):
    """The latest samples of channels that changed."""

    samples: list[SampleItem]


class SourceDocument(Document):
    """One source and how it is."""

    name: str = Field(examples=["pt100"])
    driver: str = Field(examples=["modbus-tcp"])
    up: bool = Field(description="Whether it answers.")
    detail: str = Field(description="What it last reported.", examples=["ok"])
    age_s: Number = Field(description="Process seconds since its last good value; null: none yet.")


class ServiceHealth(Document):
    """All sources, once a second."""

    sources: list[SourceDocument]
    degraded: bool = Field(description="Whether any source is down.")
    clock_rate: float = Field(description="Process seconds per wall second.")


class Heartbeat(Document):
    """Nothing but that the service works."""


# ---------------------------------------------------------------------------- the messages
class _Message(Document):
    seq: int = Field(ge=0, description="Number of the message, counted from the service's start.")
    epoch: str = Field(description="Names this start of the service; numbers of others differ.")
    asset: str | None = Field(description="Null: about the service as a whole.")
    time: Time = Field(description="Process time of the data.")
    sent_at: Time = Field(description="Wall time of the message.")


class HelloMessage(_Message):
    """The first message of each asset: its snapshot."""

    type: Literal["hello"]
    gap: bool = Field(description="Whether messages after `resume` are gone.")
    data: Snapshot


class MeasurementMessage(_Message):
    """Samples that came in, at most four times a second."""

    type: Literal["measurement"]
    data: NewSamples


class StateOfAssetMessage(_Message):
    """The estimate of the node temperatures, at most twice a second."""

    type: Literal["state"]
    data: StateMessage


class VerdictMessage(_Message):
    """The verdict, at each change and at least every 5 s."""

    type: Literal["verdict"]
    data: VerdictDocument


class ForecastMessage(_Message):
    """A new live forecast."""

    type: Literal["forecast"]
    data: LiveForecast


class AlarmMessage(_Message):
    """An alarm that changed."""

    type: Literal["alarm"]
    data: AlarmDocument


class JobMessage(_Message):
    """An identification job that changed or went on."""

    type: Literal["job"]
    data: JobDocument


class HealthMessage(_Message):
    """How the sources are, once a second."""

    type: Literal["health"]
    data: ServiceHealth


class HeartbeatMessage(_Message):
    """The service works, every 15 s."""

    type: Literal["heartbeat"]
    data: Heartbeat


MESSAGES: dict[str, type[_Message]] = {
    get_args(model.model_fields["type"].annotation)[0]: model
    for model in (
        HelloMessage,
        MeasurementMessage,
        StateOfAssetMessage,
        VerdictMessage,
        ForecastMessage,
        AlarmMessage,
        JobMessage,
        HealthMessage,
        HeartbeatMessage,
    )
}
"""Model of each kind of message."""


def asyncapi_document(version: str, address: str) -> JsonSchemaValue:
    """Describe the stream as AsyncAPI 3 does."""
    references, definitions = models_json_schema(
        [(model, "serialization") for model in MESSAGES.values()],
        ref_template="#/components/schemas/{model}",
    )
    return {
        "asyncapi": "3.0.0",
        "info": {
            "title": "Bearing Twin: live stream",
            "version": version,
            "description": "JSON messages over WebSocket. `hello` comes first for each asset; "
            "after a break, `resume` and `epoch` bring what was missed. Of an asset that no client "
            "has followed for ten minutes, only `alarm` and `job` are sent; `gap` says so to a "
            "client that resumes from before that. A client that reads slowly loses old "
            "measurements, never alarms or jobs.",
        },
        "defaultContentType": "application/json",
        "channels": {
            "stream": {
                "address": address,
                "title": "Live messages",
                "messages": {kind: {"$ref": f"#/components/messages/{kind}"} for kind in MESSAGES},
                "bindings": {
                    "ws": {
                        "method": "GET",
                        "query": {
                            "type": "object",
                            "properties": {
                                "assets": {
                                    "type": "string",
                                    "description": "Asset ids, comma-separated; absent: all.",
                                },
                                "live": {"type": "string", "description": LIVE},
                                "resume": {
                                    "type": "integer",
                                    "minimum": 0,
                                    "description": "Number of the last message seen.",
                                },
                                "epoch": {
                                    "type": "string",
                                    "description": "Epoch of that message.",
                                },
                            },
                        },
                    }
                },
            }
        },
        "operations": {
            "sendMessages": {
                "action": "send",
                "channel": {"$ref": "#/channels/stream"},
                "summary": "The service sends messages to the client that opened the stream.",
            }
        },
        "components": {
            "messages": {
                kind: {
                    "name": kind,
                    "summary": (model.__doc__ or "").strip(),
                    "payload": references[(model, "serialization")],
                }
                for kind, model in MESSAGES.items()
            },
            "schemas": definitions["$defs"],
        },
    }
