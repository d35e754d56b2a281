"""Tags and alarms to an MQTT broker (extra ``mqtt``)."""
