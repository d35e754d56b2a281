"""What clients find of the history in the address space: what the server can, of which nodes."""

from typing import Final

from asyncua import Node, Server, ua

from service.plant.opcua.history import AGGREGATES, MOST_NODES, MOST_VALUES

_CAPABILITIES: Final = {
    ua.ObjectIds.HistoryServerCapabilities_AccessHistoryDataCapability: True,
    ua.ObjectIds.HistoryServerCapabilities_AccessHistoryEventsCapability: False,
    ua.ObjectIds.HistoryServerCapabilities_InsertDataCapability: False,
    ua.ObjectIds.HistoryServerCapabilities_ReplaceDataCapability: False,
    ua.ObjectIds.HistoryServerCapabilities_UpdateDataCapability: False,
    ua.ObjectIds.HistoryServerCapabilities_DeleteRawCapability: False,
    ua.ObjectIds.HistoryServerCapabilities_DeleteAtTimeCapability: False,
    ua.ObjectIds.HistoryServerCapabilities_InsertEventCapability: False,
    ua.ObjectIds.HistoryServerCapabilities_ReplaceEventCapability: False,
    ua.ObjectIds.HistoryServerCapabilities_UpdateEventCapability: False,
    ua.ObjectIds.HistoryServerCapabilities_DeleteEventCapability: False,
    ua.ObjectIds.HistoryServerCapabilities_InsertAnnotationCapability: False,
    ua.ObjectIds.HistoryServerCapabilities_ServerTimestampSupported: False,
}
_LIMITS: Final = {
    ua.ObjectIds.HistoryServerCapabilities_MaxReturnDataValues: MOST_VALUES,
    ua.ObjectIds.Server_ServerCapabilities_OperationLimits_MaxNodesPerHistoryReadData: MOST_NODES,
}
#: An interval with any good sample is good; uncertain samples do not count as good.
_AGGREGATE_CONFIGURATION: Final = {
    "TreatUncertainAsBad": ua.Variant(True),
    "PercentDataBad": ua.Variant(100, ua.VariantType.Byte),
    "PercentDataGood": ua.Variant(1, ua.VariantType.Byte),
    "UseSlopedExtrapolation": ua.Variant(False),
}


async def describe_history(server: Server, configuration: ua.NodeId) -> None:
    """Fill in the capabilities, and make the configuration that all historical variables share."""
    for number, value in _CAPABILITIES.items():
        await server.get_node(number).write_value(value)
    for number, most in _LIMITS.items():
        await server.get_node(number).write_value(ua.Variant(most, ua.VariantType.UInt32))
    for folder in (
        ua.ObjectIds.HistoryServerCapabilities_AggregateFunctions,
        ua.ObjectIds.Server_ServerCapabilities_AggregateFunctions,
    ):
        for aggregate in AGGREGATES:
            await server.get_node(folder).add_reference(
                ua.NodeId(aggregate), ua.ObjectIds.Organizes, bidirectional=False
            )
    capabilities = server.get_node(ua.ObjectIds.HistoryServerCapabilities)
    node = await capabilities.add_object(
        configuration,
        "0:HA Configuration",
        ua.ObjectIds.HistoricalDataConfigurationType,
        instantiate_optional=False,
    )
    await (await node.get_child("0:Stepped")).write_value(True)
    for name, value in _AGGREGATE_CONFIGURATION.items():
        path = ["0:AggregateConfiguration", f"0:{name}"]
        await (await node.get_child(path)).write_value(value)


async def mark_historical(variable: Node, configuration: ua.NodeId) -> None:
    """Show that a variable has a history; how it is to be read the configuration says."""
    await variable.write_attribute(ua.AttributeIds.Historizing, ua.DataValue(True))
    for attribute in (ua.AttributeIds.AccessLevel, ua.AttributeIds.UserAccessLevel):
        await variable.set_attr_bit(attribute, ua.AccessLevel.HistoryRead)
    await variable.add_reference(
        configuration, ua.ObjectIds.HasHistoricalConfiguration, bidirectional=False
    )
