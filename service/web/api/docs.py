"""The API description, and a page to read and try it that loads nothing from elsewhere."""

import json
from pathlib import Path
from typing import Any, Final

from fastapi import FastAPI
from fastapi.openapi.utils import get_openapi
from pydantic_core import to_json
from starlette.responses import HTMLResponse, Response
from starlette.staticfiles import StaticFiles

from service.documents.messages import asyncapi_document
from service.documents.problems import ProblemDocument
from service.feature_folders import declared, modules
from service.web.api.access import AUDIT, SECURITY_SCHEMES, problems

#: Description of the stream, beside that of the calls (`/openapi.json`).
ASYNCAPI_PATH: Final = "/asyncapi.json"
STREAM_PATH: Final = "/api/v1/stream"
_EXAMPLES = Path(__file__).parent / "examples.json"
_STATIC = Path(__file__).parent / "static"
_PAGE: Final = """<!doctype html>
<html lang="en">
<head>
<meta charset="utf-8">
<title>Bearing Twin API</title>
<meta name="viewport" content="width=device-width, initial-scale=1">
<link rel="icon" href="/favicon.svg">
<link rel="stylesheet" href="/docs/files/swagger-ui/swagger-ui.css">
</head>
<body>
<div id="swagger-ui"></div>
<script src="/docs/files/swagger-ui/swagger-ui-bundle.js"></script>
<script src="/docs/files/start.js"></script>
</body>
</html>
"""
_LINK: Final = {
    "Link": {
        "description": 'Address of the next page with `rel="next"`; absent on the last page.',
        "schema": {"type": "string"},
    }
}
# The framework's own shape of a validation error is never sent.
_UNUSED_SCHEMAS = ("HTTPValidationError", "ValidationError")


def install_docs(app: FastAPI) -> None:
    """Serve ``/docs`` with files of our own, and describe security and problems in OpenAPI."""

    async def docs() -> HTMLResponse:
        return HTMLResponse(_PAGE)

    async def asyncapi() -> Response:
        body = to_json(asyncapi_document(app.version, STREAM_PATH))
        return Response(body, media_type="application/json")

    app.add_api_route("/docs", docs, include_in_schema=False)
    app.add_api_route(ASYNCAPI_PATH, asyncapi, include_in_schema=False)
    app.mount("/docs/files", StaticFiles(directory=_STATIC))
    app.openapi = lambda: _openapi(app)  # type: ignore[method-assign]


def _add_common_answers(operation: dict[str, Any]) -> None:
    """Add what the middleware may answer instead of the route."""
    statuses: tuple[int, ...] = (400, 413, 415, 500) if "requestBody" in operation else (500,)
    if operation["security"] and "parameters" in operation:
        statuses = (400, *statuses)
    common = {str(status): text for status, text in problems(*statuses).items()}
    answers = operation["responses"] = dict(sorted((common | operation["responses"]).items()))
    if "101" in answers:
        del answers["200"]  # the framework's own, which is never sent
    if any(parameter["name"] == "cursor" for parameter in operation.get("parameters", ())):
        answers["200"]["headers"] = _LINK
    operation.pop(AUDIT, None)


def _add_example(operation: dict[str, Any], example: Any) -> None:
    """Show what a real service answered to this call, with long lists cut short."""
    for status, answer in operation["responses"].items():
        if status.startswith("2") and example is not None:
            answer["content"]["application/json"]["example"] = example


def _openapi(app: FastAPI) -> dict[str, Any]:
    if app.openapi_schema is None:
        schema = get_openapi(
            title=app.title,
            version=app.version,
            description=app.description,
            routes=app.routes,
            tags=app.openapi_tags,
        )
        components = schema.setdefault("components", {})
        components["securitySchemes"] = SECURITY_SCHEMES
        schemas = components.setdefault("schemas", {})
        for name in _UNUSED_SCHEMAS:
            schemas.pop(name, None)
        # What no signature of a route names: the handlers and the route itself read and write it.
        place = "#/components/schemas/{model}"
        for added in (
            ProblemDocument.model_json_schema(ref_template=place, mode="serialization"),
            *(
                model.model_json_schema(ref_template=place)
                for model in declared("routes", "BODIES")
            ),
        ):
            schemas.update(added.pop("$defs"))
            schemas[added["title"]] = added
        schema["webhooks"] = {
            name: webhook
            for _, feature in modules("routes")
            for name, webhook in getattr(feature, "WEBHOOKS", {}).items()
        }
        examples = json.loads(_EXAMPLES.read_text(encoding="utf-8"))
        for path, item in schema["paths"].items():
            for method, operation in item.items():
                _add_common_answers(operation)
                _add_example(operation, examples.get(f"{method.upper()} {path}"))
                if roles := operation.get("x-roles"):
                    operation["description"] += f"\n\nRoles: {', '.join(roles)}."
        app.openapi_schema = schema
    return app.openapi_schema
