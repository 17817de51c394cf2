"""Proof of a sender's address, which may be forged: before it the gateway sends little there (R20.13)."""

from __future__ import annotations

REFLECTED = 3
"""How many times the bytes received from an unproven address may be sent there (RFC 9000, section 8.1)."""


class AddressProof:
    """The proof of one address: it `is_proven` once it has answered with an id that was sent to it alone."""

    def __init__(self) -> None:
        self.is_proven = False
        self._credit = 0

    def came(self, size: int) -> None:
        """A datagram of `size` bytes arrived from the address."""
        self._credit += REFLECTED * size

    def takes(self, size: int) -> bool:
        """Whether `size` bytes may be sent there; if so, charges them."""
        if self.is_proven:
            return True
        if size > self._credit:
            return False
        self._credit -= size
        return True
