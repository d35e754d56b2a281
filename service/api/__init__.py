"""REST, WebSocket and the static page: one router per noun, all under ``/api/v1``."""
