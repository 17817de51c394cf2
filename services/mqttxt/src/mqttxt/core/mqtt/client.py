"""The paho-mqtt client of every connection, and its socket."""

from __future__ import annotations

import asyncio
import contextlib
import socket
import ssl
import threading
from collections.abc import Callable
from functools import partial
from typing import Any, TypeVar, cast

from paho.mqtt.client import Client
from paho.mqtt.enums import CallbackAPIVersion, MQTTProtocolVersion

from ..address import BrokerAddress
from ..effects import Will
from .buffered import Buffered
from .properties import connect_properties

KEEPALIVE_S = 15
"""Above the 10 s between two beacons, so that a link that carries them never needs a PINGREQ. One and a half of it,
after which the broker publishes the will, is below the three beacon intervals of silence that mean the same."""
CONNECT_TIMEOUT_S = 5.0
CONNECT_THREAD = "mqttxt-connect"
T = TypeVar("T")


class _Client(Client):
    """paho's client on a socket that is read and written in bulk."""

    def _create_socket(self) -> Any:
        return Buffered(cast(socket.socket, super()._create_socket()))


def make_client(
    address: BrokerAddress, client_id: str, will: Will | None, ssl_context: ssl.SSLContext | None
) -> Client:
    """Make a client, not yet connected, that never reconnects on its own."""
    client = _Client(
        CallbackAPIVersion.VERSION2,
        client_id=client_id,
        protocol=MQTTProtocolVersion.MQTTv5,
        reconnect_on_failure=False,
        manual_ack=True,  # paho never sees a PUBLISH or a PUBACK
    )
    client.connect_timeout = CONNECT_TIMEOUT_S
    if will is not None:
        client.will_set(will.topic, will.payload, qos=1, retain=True)
    if address.username is not None:
        client.username_pw_set(address.username, address.password)
    if address.tls:
        client.tls_set_context(ssl_context or ssl.create_default_context())
    client.on_socket_open = _on_socket_open
    return client


def connect(client: Client, address: BrokerAddress, session_expiry_s: int, aliases: int) -> None:
    """Resolve, connect, shake hands and send CONNECT; blocks. Raises OSError."""
    properties = connect_properties(session_expiry_s, aliases)
    client.connect(address.host, address.port, KEEPALIVE_S, clean_start=session_expiry_s == 0, properties=properties)


def in_own_thread(call: Callable[[], T]) -> asyncio.Future[T]:
    """Run a call in a thread of its own, which does not delay the end of the process; returns a future of its result.

    A name can take long to resolve, and a process waits for the event loop's own threads before it ends.
    """
    loop = asyncio.get_running_loop()
    made: asyncio.Future[T] = loop.create_future()

    def work() -> None:
        try:
            tell = partial(made.set_result, call())
        except Exception as error:  # noqa: BLE001 - raised where the future is awaited
            tell = partial(made.set_exception, error)
        with contextlib.suppress(RuntimeError):  # the loop has ended meanwhile
            loop.call_soon_threadsafe(tell)

    threading.Thread(target=work, name=CONNECT_THREAD, daemon=True).start()
    return made


def _on_socket_open(_client: Client, _userdata: Any, sock: Any) -> None:
    """Disable Nagle's algorithm, which would hold small publishes back and dominate measured delays."""
    sock.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
