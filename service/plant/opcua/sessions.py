"""Sessions that no one can take over: the library's, with tokens that cannot be guessed."""

import secrets
from typing import Any

from asyncua import ua
from asyncua.common.utils import ServiceError
from asyncua.crypto.permission_rules import User, UserRole
from asyncua.server.internal_server import InternalServer
from asyncua.server.internal_session import InternalSession

from service.plant.opcua.subscriptions import OwnSubscriptions
from service.plant.opcua.users import KeyUsers

_TOKEN_BYTES = 32


class KeyedServer(InternalServer):  # type: ignore[misc]  # the library has no types
    """The library's server; a session lives and dies with the connection that made it.

    The library binds a connection to a session as soon as it names the session's token, before
    the key is checked, and leaves it bound when the check fails. Its tokens are numbers that
    follow each other.

    Parameters
    ----------
    users
        Who may activate a session.
    """

    def __init__(self, users: KeyUsers) -> None:
        super().__init__(user_manager=users)
        self._users = users

    def create_session(
        self, name: Any, user: User | None = None, external: bool = False
    ) -> InternalSession:
        """Make a session; the library names those from outside by their peer's address."""
        if not external:
            return super().create_session(name, user or User(role=UserRole.Anonymous))
        return _Session(self._users, self, name)

    def register_external_session(self, session: InternalSession) -> None:
        """Keep no list of sessions: there is none that another connection could find."""

    def lookup_external_session(self, auth_token: ua.NodeId) -> InternalSession | None:
        """Find nothing: a client whose connection broke makes a new session."""
        return None

    def register_server(self, server: Any, conf: Any = None) -> None:
        """Refuse: no session is asked for, and this is no discovery server."""
        raise ServiceError(ua.StatusCodes.BadServiceUnsupported)


class _Session(InternalSession):  # type: ignore[misc]
    def __init__(self, users: KeyUsers, server: KeyedServer, peer: tuple[str, int]) -> None:
        own = OwnSubscriptions(server.aspace, server)
        super().__init__(server, server.aspace, own, str(peer), external=True)
        self.auth_token = ua.NodeId(secrets.token_bytes(_TOKEN_BYTES), 0, ua.NodeIdType.ByteString)
        self._users = users
        self._address = peer[0]
        self._admitted: User | None = None

    async def admit(self, params: ua.ActivateSessionParameters) -> None:
        """Have the key checked before the session is activated, which cannot wait.

        Raises
        ------
        ServiceError
            As `KeyUsers.admit`.
        """
        self._admitted = None
        token, password = params.UserIdentityToken, None
        if isinstance(token, ua.UserNameIdentityToken):
            try:
                _, password = self.iserver.decrypt_user_token(self, token)
            except Exception:
                return  # the library comes to the same, and says what
        self._admitted = await self._users.admit(password, self._address)

    def activate_session(
        self, params: ua.ActivateSessionParameters, peer_certificate: bytes | None
    ) -> ua.ActivateSessionResult:
        self._users.admitted, self._admitted = self._admitted, None
        try:
            return super().activate_session(params, peer_certificate)
        finally:
            self._users.admitted = None
