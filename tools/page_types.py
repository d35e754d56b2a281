"""Types of the REST answers for the page's modules, made from docs/openapi.json.

``python -m tools.page_types FILE`` writes them, ``make types`` checks the modules with them. An
answer has the key of its request, such as ``GET /assets/{asset_id}/forecast``. A page that the
service could not pack at its start, such as one with two equal names at the top of two modules of
the first view, is refused here.
"""

import json
import sys
from pathlib import Path
from typing import Any

from service.web.pages import static_directory
from service.web.pages.packing import PackingError, packed_files

OPENAPI = Path(__file__).parents[1] / "docs" / "openapi.json"
PREFIX = "/api/v1"
_REFERENCE = "#/components/schemas/"
_SCALARS = {
    "string": "string",
    "integer": "number",
    "number": "number",
    "boolean": "boolean",
    "null": "null",
}

Schema = dict[str, Any]


def declarations(description: Schema) -> str:
    """Text of the declarations: a type for each schema, and the answer of each request."""
    types = [
        f"  type {_name(name)} = {_type(schema)};\n"
        for name, schema in description["components"]["schemas"].items()
    ]
    answers = [
        f"    {json.dumps(f'{method.upper()} {path.removeprefix(PREFIX)}')}: {_type(answer)};\n"
        for path, operations in description["paths"].items()
        for method, operation in operations.items()
        if (answer := _answer(operation)) is not None
    ]
    return (
        "declare namespace Api {\n"
        + "".join(types)
        + "  interface Answers {\n"
        + "".join(answers)
        + "  }\n}\n"
    )


def _answer(operation: Schema) -> Schema | None:
    """Schema of the JSON of a request that succeeded."""
    for status, response in operation.get("responses", {}).items():
        content = response.get("content", {}).get("application/json")
        if status.startswith("2") and content is not None:
            schema: Schema = content["schema"]
            return schema
    return None


def _type(schema: Schema) -> str:
    if reference := schema.get("$ref"):
        return _name(reference.removeprefix(_REFERENCE))
    if "enum" in schema or "const" in schema:
        return " | ".join(json.dumps(one) for one in schema.get("enum", [schema.get("const")]))
    if choices := schema.get("anyOf") or schema.get("oneOf"):
        return "(" + " | ".join(dict.fromkeys(_type(one) for one in choices)) + ")"
    kind = schema.get("type")
    if isinstance(kind, list):
        return " | ".join(_SCALARS[one] for one in kind)
    if kind == "array":
        return f"Array<{_type(schema.get('items', {}))}>"
    if kind == "object":
        return _object(schema)
    return _SCALARS.get(kind or "", "any")


def _object(schema: Schema) -> str:
    required = schema.get("required", ())
    members = [
        f"{json.dumps(name)}{'' if name in required else '?'}: {_type(member)}"
        for name, member in schema.get("properties", {}).items()
    ]
    others = schema.get("additionalProperties", False)
    if isinstance(others, dict):
        members.append(f"[name: string]: {_type(others) if not members else 'any'}")
    elif others or not members:
        members.append("[name: string]: any")
    return "{ " + "; ".join(members) + " }"


def _name(schema: str) -> str:
    """Name of a schema as TypeScript may have it: Json-Input is JsonInput."""
    return schema.replace("-", "")


def main(target: Path, static: Path) -> None:
    """Write the types into a file; a page that cannot be packed ends with one line."""
    try:
        packed_files(static)
    except PackingError as error:
        sys.exit(f"page: {error}")
    target.parent.mkdir(parents=True, exist_ok=True)
    target.write_text(declarations(json.loads(OPENAPI.read_text("utf-8"))), "utf-8")


if __name__ == "__main__":
    main(Path(sys.argv[1]), static_directory())
