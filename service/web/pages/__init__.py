"""The operator dashboard: static files that the service serves at ``/``.

No build step: ``static/js`` holds ES modules as the browser runs them. ``live.js`` keeps the
``store.js`` in step with REST and stream, ``situation.js`` and ``verdict.js`` turn it into the
three answers (pure functions), the modules in ``views`` draw them. Elements are built with
``dom.js`` from parts, never from HTML text. Third-party parts are in ``static/vendor`` and
``static/fonts``, with their licences.
"""

from pathlib import Path


def static_directory() -> Path:
    """Directory of the dashboard's files; its ``index.html`` is the page."""
    return Path(__file__).parent / "static"
