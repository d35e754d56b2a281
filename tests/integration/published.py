"""Answers and messages of a real site, compared with what is published of them."""

import json
import re
from dataclasses import dataclass, field
from typing import Any

import httpx2
import jsonschema_rs
from patience import patience
from processes import Site


@dataclass
class Published:
    """The descriptions, and which calls and messages were held against them."""

    site: Site
    openapi: dict[str, Any]
    asyncapi: dict[str, Any]
    keys: dict[str, str] = field(default_factory=dict)
    answered: set[tuple[str, int]] = field(default_factory=set)
    received: set[str] = field(default_factory=set)

    @property
    def operations(self) -> dict[str, dict[str, Any]]:
        """Every operation by method and path."""
        return {
            f"{method.upper()} {path}": operation
            for path, item in self.openapi["paths"].items()
            for method, operation in item.items()
        }

    def operation_of(self, method: str, path: str) -> str:
        """The operation that a call belongs to; of two, that with fewer parameters."""
        names = [
            name
            for name in self.operations
            if re.fullmatch(re.sub(r"\{\w+\}", "[^/]+", name), f"{method} {path}")
        ]
        assert names, f"{method} {path} is not published"
        return min(names, key=lambda name: name.count("{"))

    def call(self, method: str, path: str, status: int, **options: Any) -> Any:
        """Make a call and hold the answer against its schema."""
        answer = self.site.client.request(method, path, **options)
        return self.check(method, path, status, answer)

    def check(self, method: str, path: str, status: int, answer: httpx2.Response) -> Any:
        name = self.operation_of(method, path)
        assert answer.status_code == status, (name, answer.status_code, answer.text[:500])
        described = self.operations[name]["responses"]
        assert str(status) in described, (name, status)
        self.answered.add((name, status))
        content = described[str(status)].get("content", {})
        if not content:
            assert not answer.content, (name, status)
            return None
        media_type = answer.headers["content-type"].partition(";")[0]
        known = {media.partition(";")[0]: one for media, one in content.items()}
        assert media_type in known, (name, status, media_type)
        if not media_type.endswith("json"):
            return answer.text
        body = json.loads(answer.content)
        self.hold(known[media_type]["schema"], body, self.openapi, f"{name} {status}")
        return body

    def hold(self, schema: dict[str, Any], body: Any, whole: dict[str, Any], name: str) -> None:
        """Hold a body against a schema of a description."""
        rooted = schema | {"components": whole["components"]}
        errors = [
            f"{'/'.join(map(str, one.instance_path))}: {one.message}"
            for one in jsonschema_rs.Draft202012Validator(
                rooted, validate_formats=True
            ).iter_errors(body)
        ]
        assert not errors, (name, errors[:5])

    def as_role(self, role: str | None) -> httpx2.Client:
        """A client with a key of a role, or with none."""
        headers = {} if role is None else {"X-API-Key": self.keys[role]}
        return httpx2.Client(
            base_url=self.site.client.base_url, headers=headers, timeout=patience(60)
        )
