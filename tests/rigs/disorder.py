"""A bridge between two brokers that delays, reorders and repeats messages."""

from __future__ import annotations

import heapq
import itertools
import random
import threading
import time
from typing import Any, Self

from paho.mqtt.client import Client, MQTTMessage
from paho.mqtt.enums import CallbackAPIVersion, MQTTProtocolVersion
from paho.mqtt.subscribeoptions import SubscribeOptions


class Disorder:
    """Carries everything both ways; while `delay_s` is set, unretained messages are delayed, repeated and reordered.

    Presence is left in order: its owners repair it, and it is not the subject of these tests.
    """

    def __init__(self, port: int, other_port: int) -> None:
        self.delay_s = 0.0
        self.held_back = self.repeated = 0
        self._clients = [self._client(port), self._client(other_port)]
        self._due: list[tuple[float, int, Client, MQTTMessage]] = []
        self._count = itertools.count()
        self._changed = threading.Condition()
        self._ended = False
        self._thread = threading.Thread(target=self._carry, daemon=True)

    def start(self) -> Self:
        for client in self._clients:
            client.loop_start()
        self._thread.start()
        return self

    def close(self) -> None:
        with self._changed:
            self._ended = True
            self._changed.notify()
        self._thread.join()
        for client in self._clients:
            client.disconnect()
            client.loop_stop()

    def _client(self, port: int) -> Client:
        client = Client(CallbackAPIVersion.VERSION2, protocol=MQTTProtocolVersion.MQTTv5)
        client.max_inflight_messages_set(1000)
        client.on_message = self._take
        options = SubscribeOptions(qos=1, noLocal=True, retainAsPublished=True)

        def subscribe(_client: Client, _data: Any, _flags: Any, _code: Any, _properties: Any) -> None:
            client.subscribe([("#", options)])

        client.on_connect = subscribe
        client.connect("127.0.0.1", port)
        return client

    def _take(self, source: Client, _data: Any, message: MQTTMessage) -> None:
        target = self._clients[1 - self._clients.index(source)]
        delays = [0.0]
        if self.delay_s and not message.retain:
            delays = [random.uniform(0, self.delay_s) if random.random() < 0.5 else 0.0]
            while random.random() < 0.3:
                delays.append(random.uniform(0, 3 * self.delay_s))
            self.held_back += delays[0] > 0
            self.repeated += len(delays) - 1
        with self._changed:
            for delay_s in delays:
                heapq.heappush(self._due, (time.monotonic() + delay_s, next(self._count), target, message))
            self._changed.notify()

    def _carry(self) -> None:
        while True:
            with self._changed:
                left_s = self._due[0][0] - time.monotonic() if self._due else None
                if self._ended:
                    return
                if left_s is None or left_s > 0:
                    self._changed.wait(left_s)
                    continue
                _, _, target, message = heapq.heappop(self._due)
            target.publish(message.topic, message.payload, message.qos, message.retain)
