"""The roles, and which of them a call asks for; a new one is a row here and one in ``app.js``.

Viewer, operator, engineer and admin each may do all that the one before may. A gateway stands
apart: it pushes measurements and reads the list of assets, nothing else.
"""

from typing import Final, Literal, get_args

Role = Literal["viewer", "operator", "engineer", "admin", "gateway"]
Roles = frozenset[Role]

ROLES: Final[tuple[Role, ...]] = get_args(Role)

ADMIN: Final[Roles] = frozenset({"admin"})
ENGINEER: Final[Roles] = ADMIN | {"engineer"}
OPERATOR: Final[Roles] = ENGINEER | {"operator"}
VIEWER: Final[Roles] = OPERATOR | {"viewer"}
PUSH: Final[Roles] = ADMIN | {"gateway"}
VIEWER_OR_GATEWAY: Final[Roles] = VIEWER | {"gateway"}
