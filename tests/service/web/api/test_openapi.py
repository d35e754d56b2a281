"""What /openapi.json promises, and that its examples keep to it."""

import json
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any, get_args

import jsonschema_rs
import pytest

from service.documents.messages import MessageType
from service.domain.texts import ONE_LINE
from service.web.api.app import descriptions

JSON = "application/json"
PROBLEM = "application/problem+json"
DOCS = Path(__file__).parents[4] / "docs"


@pytest.fixture
async def description(world: Any) -> dict[str, Any]:
    schema: dict[str, Any] = (await world.client().get("/openapi.json")).json()
    return schema


def operations(description: dict[str, Any]) -> Iterator[tuple[str, dict[str, Any]]]:
    for path, item in description["paths"].items():
        for method, operation in item.items():
            yield f"{method.upper()} {path}", operation


def check(description: dict[str, Any], schema: dict[str, Any], example: Any, name: str) -> None:
    whole = schema | {"components": description["components"]}
    jsonschema_rs.meta.validate(schema)
    errors = [str(error) for error in jsonschema_rs.iter_errors(whole, example)]
    assert not errors, (name, errors)


async def test_it_is_3_1_and_every_call_says_what_it_does(description: dict[str, Any]) -> None:
    assert description["openapi"].startswith("3.1.")
    for name, operation in operations(description):
        assert operation["summary"], name
        assert operation["description"], name
        assert operation["tags"], name


async def test_every_error_is_a_problem_and_says_when_to_come_again(
    description: dict[str, Any],
) -> None:
    for name, operation in operations(description):
        errors = {
            int(status): answer
            for status, answer in operation["responses"].items()
            if int(status) >= 400 and name != "GET /readyz"
        }
        for status, answer in errors.items():
            assert list(answer["content"]) == [PROBLEM], (name, status)
            assert ("Retry-After" in answer.get("headers", {})) == (status in (429, 503)), name
        expected = {401, 403, 422, 429, 503} if operation["security"] else set()
        if name == "GET /metrics":
            expected -= {422}
        if "requestBody" in operation:
            expected |= {400, 413, 415, 422}
        # What PUT does not find it makes.
        if "{" in name and not name.startswith(("POST /api/v1/session", "PUT ")):
            expected |= {404}
        assert expected <= errors.keys(), (name, expected - errors.keys())


async def test_listings_with_a_cursor_tell_of_their_link(description: dict[str, Any]) -> None:
    for name, operation in operations(description):
        if "cursor" in {parameter["name"] for parameter in operation.get("parameters", ())}:
            assert "Link" in operation["responses"]["200"]["headers"], name


async def test_every_parameter_says_what_it_is(description: dict[str, Any]) -> None:
    for name, operation in operations(description):
        for parameter in operation.get("parameters", ()):
            assert parameter.get("description"), (name, parameter["name"])


async def test_every_body_and_answer_has_an_example_that_fits(description: dict[str, Any]) -> None:
    for name, operation in operations(description):
        body = operation.get("requestBody", {}).get("content", {}).get(JSON)
        if body:
            examples = _examples(description, body["schema"])
            assert examples, name
            for example in examples:
                check(description, body["schema"], example, name)
        for status, answer in operation["responses"].items():
            content = answer.get("content", {}).get(JSON)
            if status.startswith("2") and content:
                assert "example" in content, (name, status)
                check(description, content["schema"], content["example"], name)


def open_parts(schema: Any, where: str = "") -> Iterator[str]:
    """Places of a schema that say nothing about what stands there."""
    if isinstance(schema, list):
        for number, one in enumerate(schema):
            yield from open_parts(one, f"{where}/{number}")
    if not isinstance(schema, dict):
        return
    beyond = schema.get("additionalProperties", True)
    if schema.get("type") == "object" and beyond is True:
        yield where
    if not schema.keys() & {"type", "$ref", "anyOf", "oneOf", "enum", "const"}:
        yield where
    for name, one in schema.get("properties", {}).items():
        yield from open_parts(one, f"{where}/{name}")
    for key in ("additionalProperties", "items", "anyOf", "oneOf"):
        if isinstance(schema.get(key), dict | list):
            below = schema[key] if isinstance(schema[key], list) else [schema[key]]
            for one in below:
                yield from open_parts(one, f"{where}/{key}")


def answers_of(description: dict[str, Any]) -> set[str]:
    """Names of the schemas that answers are made of."""
    schemas = description["components"]["schemas"]
    found: set[str] = set()
    waiting = {
        name
        for _, operation in operations(description)
        for name in re.findall(r"#/components/schemas/(\w+)", json.dumps(operation["responses"]))
    }
    while waiting - found:
        name = (waiting - found).pop()
        found.add(name)
        waiting |= set(re.findall(r"#/components/schemas/(\w+)", json.dumps(schemas[name])))
    return found


async def test_no_answer_leaves_open_what_it_holds(description: dict[str, Any]) -> None:
    schemas = description["components"]["schemas"]
    for name in answers_of(description):
        assert list(open_parts(schemas[name], name)) == []


def test_no_message_leaves_open_what_it_holds() -> None:
    stream = descriptions()["asyncapi.json"]
    for name, schema in stream["components"]["schemas"].items():
        assert list(open_parts(schema, name)) == []
        jsonschema_rs.meta.validate(schema)
    assert set(stream["components"]["messages"]) == {"hello", *get_args(MessageType)}


async def test_the_descriptions_in_the_repository_are_those_that_are_served(world: Any) -> None:
    """A change of the interface is a decision: `make descriptions` writes it down."""
    for name, document in descriptions().items():
        kept = json.loads((DOCS / name).read_text())
        assert kept == document, f"docs/{name} differs; 'make descriptions' writes it"
        served = (await world.client().get(f"/{name}")).json()
        assert served == document


def _examples(description: dict[str, Any], schema: dict[str, Any]) -> list[Any]:
    """Examples of the first model that a schema refers to."""
    for one in (schema, *schema.get("anyOf", ())):
        if "$ref" in one:
            model = description["components"]["schemas"][one["$ref"].rpartition("/")[2]]
            examples: list[Any] = model.get("examples", [])
            return examples
    return []


#: What callers write for people, wherever it stands in a body.
_WORDS = {
    *("comment", "label", "name", "text", "remarks", "class", "operator_action", "rationalised_by"),
    *("probable_causes", "consequence_of_inaction", "severity_of_consequence"),
    "identification_method",
}
#: A file, and its name with a pattern of its own.
_FILES = {"DbcUpload"}


async def test_a_text_for_people_is_one_line_in_every_body(description: dict[str, Any]) -> None:
    schemas = description["components"]["schemas"]
    waiting = [
        schema
        for _, operation in operations(description)
        for content in operation.get("requestBody", {}).get("content", {}).values()
        for schema in [content["schema"]]
    ]
    seen: set[str] = set()
    found = 0
    while waiting:
        schema = waiting.pop()
        name = schema.get("$ref", "").rpartition("/")[2]
        if name and name not in seen | _FILES:
            seen.add(name)
            waiting.append(schemas[name])
        for key, part in schema.get("properties", {}).items():
            texts = [one for one in (part, *part.get("anyOf", ())) if one.get("type") == "string"]
            if key in _WORDS:
                found += len(texts)
                assert all(one["pattern"] == ONE_LINE for one in texts), (schema["title"], key)
            waiting += [part, *part.get("anyOf", ()), part.get("items", {})]
    assert found >= 15
