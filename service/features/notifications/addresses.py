"""E-mail addresses with letters other than those of ASCII."""


def sent_address(address: str) -> str:
    """Give an address as mail servers know it: its domain in ASCII (RFC 5890).

    Raises `ValueError` if the domain has no such form.
    """
    name, _, domain = address.rpartition("@")
    if domain.isascii():
        return address
    import idna  # its tables take memory that most sites need not pay

    return f"{name}@{idna.encode(domain, uts46=True).decode()}"


def is_plain_address(address: str) -> bool:
    """Whether every mail server takes the address: the name before the domain is ASCII.

    Others ask for the extension SMTPUTF8 (RFC 6531).
    """
    return address.rpartition("@")[0].isascii()
