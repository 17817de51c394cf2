"""The SUBSCRIBEs of a connection, one at a time: a broker may take a second one for a repetition of the first."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Sequence

from paho.mqtt.client import Client
from paho.mqtt.subscribeoptions import SubscribeOptions

from ..effects import Subscribe

UNSPECIFIED = 0x80
"""The lowest of MQTT's reason codes that are errors."""
_NEVER_GRANTED = frozenset({0x87, 0x8F, 0x9E, 0xA1, 0xA2})
"""SUBACK reason codes for which a retry is pointless (MQTT 5.0, 3.9.3)."""


class Subscriptions:
    """The queue of a client's subscriptions. `granted` is called with each granted effect, `refused` for a refusal.

    The arguments of `refused` are the filter, the reason code, and whether a retry is pointless.
    """

    def __init__(
        self, client: Client, granted: Callable[[Subscribe], None], refused: Callable[[str, int, bool], None]
    ) -> None:
        self._client = client
        self._granted = granted
        self._refused = refused
        self._waiting: deque[Subscribe] = deque()
        self.under_way: int | None = None
        """The packet id of the SUBSCRIBE that is not answered."""

    def subscribe(self, effect: Subscribe) -> None:
        """Subscribe once the earlier subscriptions are answered."""
        self._waiting.append(effect)
        if self.under_way is None:
            self._send_next()

    def on_suback(self, mid: int, codes: Sequence[int]) -> None:
        """The broker has answered the SUBSCRIBE with packet id `mid`: one reason code per filter."""
        if mid != self.under_way:
            return
        self.under_way = None
        effect = self._waiting.popleft()
        answers = dict(zip(effect.filters, codes, strict=False))
        refused = {topic: code for topic in effect.filters if (code := answers.get(topic, UNSPECIFIED)) >= UNSPECIFIED}
        if refused:
            topic, code = next(((t, c) for t, c in refused.items() if c in _NEVER_GRANTED), next(iter(refused.items())))
            self._refused(topic, code, code in _NEVER_GRANTED)
            return
        if self._waiting:
            self._send_next()
        self._granted(effect)

    def _send_next(self) -> None:
        effect = self._waiting[0]
        handling = (
            SubscribeOptions.RETAIN_DO_NOT_SEND if effect.live_only else SubscribeOptions.RETAIN_SEND_ON_SUBSCRIBE
        )
        options = SubscribeOptions(qos=1, retainAsPublished=effect.live_only, retainHandling=handling)
        _, self.under_way = self._client.subscribe([(topic, options) for topic in effect.filters])
