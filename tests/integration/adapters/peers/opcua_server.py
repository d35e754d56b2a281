"""An OPC UA server in a process of its own, with the history of a PLC that never stops.

Value k of TIC101.PV belongs to the moment ORIGIN + k * 0.2 s, whether the server ran then or not;
every 25th has a sensor failure. TIC102.PV is the same without history, TIC103.PV never changes,
TIC104.PV is written by the test, those of UNITS state a unit, the others are strange.
"""

import asyncio
import datetime as dt
import logging
import sys
from pathlib import Path
from typing import Any

from asyncua import Server, ua
from asyncua.crypto.cert_gen import setup_self_signed_certificate
from asyncua.crypto.permission_rules import User, UserRole
from asyncua.crypto.validator import CertificateValidator, CertificateValidatorOptions
from asyncua.server.history import HistoryDict
from cryptography.x509.oid import ExtendedKeyUsageOID

logging.getLogger("asyncua").setLevel(logging.CRITICAL)
STEP_S = 0.2
NOW = dt.datetime.now
STRANGE = {
    "text": ua.Variant("a string"),
    "array": ua.Variant([1.0, 2.0]),
    "nan": ua.Variant(float("nan")),
    "infinite": ua.Variant(float("inf")),
    "null": ua.Variant(None),
    "time": ua.Variant(dt.datetime(2026, 1, 1, tzinfo=dt.UTC)),
    "huge": ua.Variant(2**63 - 1, ua.VariantType.Int64),
    "flag": ua.Variant(True),
}

UNITS = {
    "t_kelvin_c": ("K", 296.15),
    "t_pressure_c": ("bar", 3.0),
    "load_n": ("kN", 2.65),
    "t_silent_c": ("K", 296.15),  # it is not said before the test writes it
}


def value(k: int, origin: dt.datetime) -> ua.DataValue:
    at = origin + dt.timedelta(seconds=k * STEP_S)
    if k % 25 == 24:
        bad = ua.StatusCode(ua.StatusCodes.BadSensorFailure)
        return ua.DataValue(ua.Variant(None), StatusCode=bad, SourceTimestamp=at)
    return ua.DataValue(ua.Variant(20.0 + k, ua.VariantType.Double), SourceTimestamp=at)


def reached(origin: dt.datetime) -> int:
    return int((NOW(dt.UTC) - origin).total_seconds() / STEP_S)


class Buffer(HistoryDict):  # type: ignore[misc]
    def __init__(self, origin: dt.datetime) -> None:
        super().__init__()
        self.origin = origin

    async def read_node_history(self, node_id: Any, start: Any, end: Any, most: int) -> Any:
        if node_id.Identifier != "TIC101.PV":
            raise ua.UaStatusCodeError(ua.StatusCodes.BadHistoryOperationUnsupported)
        # As in some products the newest value is not in the history yet.
        every = [value(k, self.origin) for k in range(reached(self.origin))]
        found = [one for one in every if start <= one.SourceTimestamp <= end]
        return found[:7], found[7].SourceTimestamp if len(found) > 7 else None


class Users:
    def get_user(
        self, iserver: Any, username: str | None = None, password: str | None = None, **_: Any
    ) -> User | None:
        return User(UserRole.User) if (username, password) == ("twin", "secret") else None


async def main(port: int, origin: dt.datetime, folder: Path | None) -> None:
    server = Server(user_manager=None if folder is None else Users())
    server.iserver.history_manager.set_storage(Buffer(origin))
    await server.init()
    server.set_endpoint(f"opc.tcp://127.0.0.1:{port}/plc")
    if folder is None:
        server.set_security_policy([ua.SecurityPolicyType.NoSecurity])
    else:
        server.set_security_policy([ua.SecurityPolicyType.Basic256Sha256_SignAndEncrypt])
        for name, usage in (
            ("server", ExtendedKeyUsageOID.SERVER_AUTH),
            ("client", ExtendedKeyUsageOID.CLIENT_AUTH),
            ("other", ExtendedKeyUsageOID.SERVER_AUTH),
        ):
            uri = "urn:example:plc" if name == "server" else f"urn:example:{name}"
            await setup_self_signed_certificate(
                folder / f"{name}.pem", folder / f"{name}.der", uri, "localhost", [usage], {}
            )
        await server.set_application_uri("urn:example:plc")
        await server.load_certificate(str(folder / "server.der"))
        await server.load_private_key(str(folder / "server.pem"))
        server.set_certificate_validator(
            CertificateValidator(CertificateValidatorOptions.BASIC_VALIDATION)
        )
    space = await server.register_namespace("urn:example:plc")
    nodes = {}
    others = ("TIC102.PV", "TIC103.PV", "TIC104.PV", "untimed", "future", "overflow")
    for name in ("TIC101.PV", *others, *STRANGE):
        start = STRANGE.get(name, ua.Variant(0.0))
        any_type = ua.NodeId(ua.ObjectIds.BaseDataType) if name in STRANGE else None
        node_id = ua.NodeId(name, space)
        nodes[name] = await server.nodes.objects.add_variable(node_id, name, start, None, any_type)
    await nodes["TIC101.PV"].set_attr_bit(ua.AttributeIds.AccessLevel, ua.AccessLevel.HistoryRead)
    await nodes["TIC104.PV"].set_writable()
    for name, (unit, number) in UNITS.items():
        node = await server.nodes.objects.add_variable(ua.NodeId(name, space), name, number)
        about = ua.EUInformation(
            NamespaceUri="http://www.opcfoundation.org/UA/units/un/cefact",
            DisplayName=ua.LocalizedText(unit),
        )
        place, title = ua.NodeId(f"{name}/eu", space), ua.QualifiedName("EngineeringUnits", 0)
        unit = await node.add_property(place, title, about)
        await unit.set_writable()
        if name == "t_silent_c":
            failed = ua.DataValue(StatusCode=ua.StatusCode(ua.StatusCodes.BadInternalError))
            await server.write_attribute_value(unit.nodeid, failed)
    an_hour_ago = origin - dt.timedelta(hours=1)

    async def write(name: str, what: ua.DataValue) -> None:
        await server.write_attribute_value(nodes[name].nodeid, what)

    await write("TIC103.PV", ua.DataValue(ua.Variant(33.0), SourceTimestamp=an_hour_ago))
    for name, strange in STRANGE.items():
        await write(name, ua.DataValue(strange, SourceTimestamp=NOW(dt.UTC)))
    lost = ua.StatusCode(0x480)
    async with server:
        sys.stdout.write("listening\n")
        sys.stdout.flush()
        last = -1
        while True:
            k = reached(origin)
            if k != last:
                last = k
                await write("TIC101.PV", value(k, origin))
                await write("TIC102.PV", value(k, origin))
                now = NOW(dt.UTC)
                untimed = ua.DataValue(ua.Variant(float(k)), ServerTimestamp=now)
                await write("untimed", untimed)
                ahead = now + dt.timedelta(days=400)
                await write("future", ua.DataValue(ua.Variant(float(k)), SourceTimestamp=ahead))
                await write(
                    "overflow",
                    ua.DataValue(ua.Variant(float(k)), StatusCode=lost, SourceTimestamp=now),
                )
            await asyncio.sleep(STEP_S / 10)


asyncio.run(
    main(
        int(sys.argv[1]),
        dt.datetime.fromisoformat(sys.argv[2]),
        Path(sys.argv[3]) if len(sys.argv) > 3 else None,
    )
)
