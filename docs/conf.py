"""Sphinx: `make docs` turns this folder into a site with search, and fails on any warning."""

project = "Bearing Twin"
author = "The authors of Bearing Twin"
extensions = ["myst_parser"]
exclude_patterns: list[str] = []
# Links to headings, down to the fourth level, as on every Git server.
myst_heading_anchors = 4
# Nothing is looked up by a program's name: `text` in backquotes is text.
nitpicky = True

html_theme = "furo"
html_title = "Bearing Twin"
html_show_sphinx = False
html_copy_source = False
html_theme_options = {"source_edit_link": ""}
