"""What an asset's machine is: a bearing by name or dimensions, or a thermal network of one's own.

Everything here is configuration; `service.site.machines.machine` builds the model from it.
"""
