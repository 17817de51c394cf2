"""How a node's connections are protected: by its identity, or, only on request, not at all.

Errors name parameters, as `identity`; the command shows them as its options.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Self

from ..errors import ConfigurationError
from .address import BrokerAddress

if TYPE_CHECKING:
    from ..security.identity import Identity
    from ..security.seal import Seal


@dataclass(frozen=True)
class Transport:
    """`identity` proves this node to the brokers of its fleet; `insecure` allows connections without encryption."""

    identity: Identity | None = None
    insecure: bool = False

    def __post_init__(self) -> None:
        if self.identity is not None and self.insecure:
            raise ConfigurationError("`insecure`: expected none beside `identity`")

    @classmethod
    def of(cls, folder: Path | None, insecure: bool, name: str) -> Self:
        """The transport of the node `name` (`fog1`, `drone3`); raises ConfigurationError for another one's identity."""
        if folder is None:
            return cls(None, insecure)
        from ..security.identity import Identity

        identity = Identity.load(folder)
        if identity.name != name:
            raise ConfigurationError(f"`identity` {folder}: the identity of {identity.name}; expected that of {name}")
        return cls(identity, insecure)

    def seal(self, signed: bool, signed_states: bool = False, signed_readings: bool = False) -> Seal | None:
        """The seal with which this node signs, None if it does not; raises ConfigurationError without an identity."""
        for parameter, is_given in (("signed_states", signed_states), ("signed_readings", signed_readings)):
            if is_given and not signed:
                raise ConfigurationError(f"`{parameter}`: expected `signed` beside it")
        if not signed:
            return None
        if self.identity is None:
            raise ConfigurationError("`signed`: expected `identity` beside it")
        from ..security.seal import Seal

        return Seal(self.identity, signed_states, signed_readings)

    def check(self, address: BrokerAddress, option: str, signed: bool = False) -> BrokerAddress:
        """Return `address` if connections to it are protected; raises ConfigurationError if not.

        `mqtts://` without an identity relies on passwords and the system's certificate authorities. Datagrams are
        protected by the signatures of their messages, if messages are `signed`. Without an identity loopback needs no
        protection, and with `insecure` no address does.
        """
        if address.datagrams and self.identity is not None:
            if not signed:
                raise ConfigurationError(f"{option} {address}: not encrypted; expected `signed` beside `identity`")
            return address
        if address.tls:
            return address
        if self.identity is not None:
            raise ConfigurationError(f"{option} {address}: not encrypted; expected mqtts:// beside `identity`")
        if not (address.is_loopback or self.insecure):
            how = "`signed`" if address.datagrams else "mqtts://"
            raise ConfigurationError(
                f"{option} {address}: not encrypted; expected {how} with `identity`, or `insecure`"
            )
        return address
