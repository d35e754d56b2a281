"""Sessions that no one can take over: the library's, with tokens that cannot be guessed."""

import secrets
from typing import Any

from asyncua import ua
from asyncua.common.utils import ServiceError
from asyncua.crypto.permission_rules import User, UserRole
from asyncua.server.internal_server import InternalServer
from asyncua.server.internal_session import InternalSession

from service.plant.opcua.reading import as_asked, check_stamps
from service.plant.opcua.subscriptions import OwnSubscriptions
from service.plant.opcua.users import KeyUsers

_TOKEN_BYTES = 32
#: Browses of one session that were answered in part.
MOST_BROWSES = 20


class KeyedServer(InternalServer):  # type: ignore[misc]  # the library has no types
    """The library's server; a session lives and dies with the connection that made it.

    The library binds a connection to a session as soon as it names the session's token, before
    the key is checked, and leaves it bound when the check fails. Its tokens are numbers that
    follow each other.
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
        # What is left of browses that were answered in part.
        self._left: dict[bytes, tuple[list[ua.ReferenceDescription], int]] = {}

    async def read(self, params: ua.ReadParameters) -> list[ua.DataValue]:
        """Give values as they are asked for; the library gives them whole, with both times."""
        check_stamps(params.TimestampsToReturn)
        # Also what is no number.
        if not params.MaxAge >= 0.0:
            raise ServiceError(ua.StatusCodes.BadMaxAgeInvalid)
        values = await super().read(params)
        return [
            as_asked(value, node, params.TimestampsToReturn)
            for value, node in zip(values, params.NodesToRead, strict=True)
        ]

    async def browse(self, params: ua.BrowseParameters) -> list[ua.BrowseResult]:
        """Give as many references of a node as were asked for; the rest with `browse_next`."""
        if not params.View.ViewId.is_null():
            raise ServiceError(ua.StatusCodes.BadViewIdUnknown)  # there are none
        results = await super().browse(params)
        for result, wanted in zip(results, params.NodesToBrowse, strict=True):
            if wanted.BrowseDirection == ua.BrowseDirection.Invalid:
                result.StatusCode = ua.StatusCode(ua.StatusCodes.BadBrowseDirectionInvalid)
        most = params.RequestedMaxReferencesPerNode
        return [self._page(result, most) for result in results]

    async def browse_next(self, parameters: ua.BrowseNextParameters) -> list[ua.BrowseResult]:
        """Give more of earlier answers, or forget them."""
        results = []
        for point in parameters.ContinuationPoints:
            left, most = self._left.pop(point, (None, 0))
            result = ua.BrowseResult()
            if left is None:
                result.StatusCode = ua.StatusCode(ua.StatusCodes.BadContinuationPointInvalid)
            elif not parameters.ReleaseContinuationPoints:
                result.References = left
                result = self._page(result, most)
            results.append(result)
        return results

    def _page(self, result: ua.BrowseResult, most: int) -> ua.BrowseResult:
        if not most or len(result.References) <= most:
            return result
        if len(self._left) >= MOST_BROWSES:
            return ua.BrowseResult(StatusCode=ua.StatusCode(ua.StatusCodes.BadNoContinuationPoints))
        result.ContinuationPoint = secrets.token_bytes(8)
        self._left[result.ContinuationPoint] = result.References[most:], most
        result.References = result.References[:most]
        return result

    async def admit(self, params: ua.ActivateSessionParameters) -> None:
        """Have the key checked before the session is activated, which cannot wait.

        Raises `ServiceError` as `KeyUsers.admit`.
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
