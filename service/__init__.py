"""The Bearing Twin service: store, live twin, jobs, alarms, REST, WebSocket, dashboard, command line."""
