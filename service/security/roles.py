"""Roles, and which of them a call asks for.

Viewer, operator, engineer and admin each may do all that the one before may. A gateway stands
beside them: it pushes measurements and reads the list of assets, nothing else.
"""

from typing import Final, get_args

from service.store import Role

Roles = frozenset[Role]

ROLES: Final[tuple[Role, ...]] = get_args(Role)

ADMIN: Final[Roles] = frozenset({"admin"})
ENGINEER: Final[Roles] = ADMIN | {"engineer"}
OPERATOR: Final[Roles] = ENGINEER | {"operator"}
VIEWER: Final[Roles] = OPERATOR | {"viewer"}
PUSH: Final[Roles] = ADMIN | {"gateway"}
VIEWER_OR_GATEWAY: Final[Roles] = VIEWER | {"gateway"}
