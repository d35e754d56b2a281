"""The plant side: what hands values on to other systems (OPC UA, MQTT)."""
