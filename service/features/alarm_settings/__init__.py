"""Settings of alarms are changed and rationalised over REST and as a sheet."""
