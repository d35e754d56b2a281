"""REST, WebSocket and the static page: one router per noun, all under ``/api/v1``."""

from service.web.api.app import create_app

__all__ = ["create_app"]
