"""What /openapi.json promises, and that its examples keep to it."""

from collections.abc import Iterator
from typing import Any

import jsonschema_rs
import pytest

JSON = "application/json"
PROBLEM = "application/problem+json"


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
        if "{" in name and not name.startswith("POST /api/v1/session"):
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


def _examples(description: dict[str, Any], schema: dict[str, Any]) -> list[Any]:
    """Examples of the first model that a schema refers to."""
    for one in (schema, *schema.get("anyOf", ())):
        if "$ref" in one:
            model = description["components"]["schemas"][one["$ref"].rpartition("/")[2]]
            examples: list[Any] = model.get("examples", [])
            return examples
    return []
