"""The snapshot's tags as an OPC UA server (extra ``opcua``)."""
