"""A sender's address may be made up: until it is proven the gateway sends little there (R20.13)."""

from __future__ import annotations

REFLECTED = 3
"""How many times the bytes that came from an address may go there before it is proven (RFC 9000, section 8.1)."""


class AddressProof:
    """Of one address. It `is_proven` once it has answered what only it was told."""

    def __init__(self) -> None:
        self.is_proven = False
        self._credit = 0

    def came(self, size: int) -> None:
        """A datagram of so many bytes came from the address."""
        self._credit += REFLECTED * size

    def takes(self, size: int) -> bool:
        """Whether so many bytes may go there; they count."""
        if self.is_proven:
            return True
        if size > self._credit:
            return False
        self._credit -= size
        return True
