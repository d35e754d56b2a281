"""What one caller has for sure: an IPv4 address, or the network of an IPv6 one."""

import ipaddress


def site_of(address: str) -> str:
    """Give the IPv4 address itself, or the IPv6 network (/64) that one site commonly has."""
    try:
        if ipaddress.ip_address(address).version == 4:
            return address
        return str(ipaddress.ip_network(f"{address.partition('%')[0]}/64", strict=False))
    except ValueError:
        return address
