"""Write the types of the Python client: ``python client/generate_documents.py``."""

import json
from pathlib import Path
from typing import Any

from datamodel_code_generator import InputFileType, generate
from datamodel_code_generator.config import GenerateConfig
from datamodel_code_generator.enums import DataModelType
from datamodel_code_generator.format import Formatter, PythonVersion

HERE = Path(__file__).parent
OPENAPI = HERE.parent / "docs" / "openapi.json"
DOCUMENTS = HERE / "bearing_twin_client" / "documents.py"
HEADER = '''\
# Generated, do not edit: python client/generate_documents.py
"""What the service sends and takes: the schemas of docs/openapi.json that the client uses."""
'''
#: What the client sends. A member that the service does not know is refused here already.
SENT = ("ForecastRequest", "IdentificationRequest")
#: What the client gets. Members may be added by a newer service; they are left out here.
RECEIVED = (
    "AdviceDocument",
    "AlarmList",
    "AssetDocument",
    "AssetList",
    "EnvelopeDocument",
    "JobDocument",
    "LiveForecast",
    "Measurements",
    "ModelDocument",
    "ModelList",
    "ProblemDocument",
    "Snapshot",
    "State",
    "VerdictDocument",
    "WhatIfAnswer",
    "WindowList",
)
#: The service checks values and says what is wrong with them; titles repeat the names.
LEFT_OUT = {
    *("title", "examples", "default", "pattern", "propertyNames"),
    *("minimum", "maximum", "exclusiveMinimum", "exclusiveMaximum"),
    *("minLength", "maxLength", "minItems", "maxItems"),
}


def documents(openapi: dict[str, Any]) -> str:
    """Python source of the types: what ``SENT`` and ``RECEIVED`` need of the description."""
    schemas = openapi["components"]["schemas"]
    sent = needed(schemas, SENT)
    kept = {
        name: bare(schemas[name], closed=name in sent)
        for name in sorted(sent | needed(schemas, RECEIVED))
    }
    text = generate(
        json.dumps({"openapi": "3.1.0", "paths": {}, "components": {"schemas": kept}}),
        config=GenerateConfig(
            input_file_type=InputFileType.OpenAPI,
            output_model_type=DataModelType.PydanticV2BaseModel,
            target_python_version=PythonVersion.PY_311,
            custom_file_header=HEADER,
            enum_field_as_literal="all",
            collapse_root_models=True,
            use_schema_description=True,
            use_field_description=True,
            use_double_quotes=True,
            use_annotated=True,
            formatters=[Formatter.BUILTIN],
        ),
    )
    assert isinstance(text, str)
    return text


def needed(schemas: dict[str, Any], roots: tuple[str, ...]) -> set[str]:
    """Names of schemas, and of all that they refer to."""
    found: set[str] = set()
    left = list(roots)
    while left:
        name = left.pop()
        if name not in found:
            found.add(name)
            left += references(schemas[name])
    return found


def references(schema: Any) -> list[str]:
    """Names of the schemas that a schema refers to."""
    if isinstance(schema, list):
        return [name for one in schema for name in references(one)]
    if not isinstance(schema, dict):
        return []
    own = [schema["$ref"].rpartition("/")[2]] if isinstance(schema.get("$ref"), str) else []
    return own + references(list(schema.values()))


def bare(schema: Any, closed: bool, names: bool = False) -> Any:
    """A schema with shape and descriptions alone; ``names``: its keys are names of members."""
    if isinstance(schema, list):
        return [bare(one, closed) for one in schema]
    if not isinstance(schema, dict):
        return schema
    return {
        key: bare(value, closed, names=key == "properties" and not names)
        for key, value in schema.items()
        if names
        or not (
            key in LEFT_OUT or (key == "additionalProperties" and value is False and not closed)
        )
    }


if __name__ == "__main__":
    DOCUMENTS.write_text(documents(json.loads(OPENAPI.read_text())))
