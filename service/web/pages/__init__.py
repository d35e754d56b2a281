"""The operator dashboard: static files that the service serves at ``/``.

No build step: ``static/js`` holds ES modules as the browser runs them; those of the first view are
sent as one (`service.web.pages.packing`). ``live.js`` keeps the ``store.js`` in step with REST and
stream, ``situation.js`` and ``verdict.js`` turn it into the three answers (pure functions), the
``view.js`` of each folder draws them. Elements are made with ``panel.js``, never from HTML text.
Third-party parts are in ``static/vendor`` and ``static/fonts``, with their licences.
"""

from pathlib import Path


def static_directory() -> Path:
    """Directory of the dashboard's files; its ``index.html`` is the page."""
    return Path(__file__).parent / "static"
