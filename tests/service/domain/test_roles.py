"""The table of roles, and the dashboard's copy of it."""

import re

from service.domain.roles import OPERATOR, PUSH, ROLES, VIEWER
from service.web.pages import static_directory


def test_each_role_may_do_what_the_one_before_may_and_a_gateway_only_pushes() -> None:
    assert VIEWER > OPERATOR
    assert "gateway" not in VIEWER
    assert {"gateway", "admin"} == PUSH


def test_the_dashboard_knows_the_roles_of_people_in_their_order() -> None:
    text = (static_directory() / "js" / "app.js").read_text(encoding="utf-8")
    found = re.search(r"const ROLES = \[(.*?)\];", text)
    assert found is not None
    shown = tuple(name.strip(" '") for name in found[1].split(","))
    assert shown == tuple(role for role in ROLES if role in VIEWER)
