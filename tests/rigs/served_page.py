"""`mqttxt gs page` as a process, and requests to it without a browser."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import aiohttp

from tests.rigs.loopback import free_port, wait_until
from tests.rigs.processes import Broker, Process, Program


class Served:
    """`mqttxt gs page` as a process; `mqttxt` is the command, by default that of the repository."""

    def __init__(
        self,
        folder: Path,
        cloud: Broker,
        name: str,
        *more: str,
        mqttxt: tuple[str, ...] = (),
        fogs: tuple[str, ...] = ("1",),
        port: int | None = None,
    ) -> None:
        self.port = port or free_port()
        self.url = f"http://127.0.0.1:{self.port}/"
        named = [word for fog in fogs for word in ("--fog", fog)]
        typed = ["gs", "page", *named, "--cloud", cloud.url, "--listen", f"127.0.0.1:{self.port}", *more]
        self.process = Program(folder, name, *mqttxt, *typed) if mqttxt else Process(folder, name, "mqttxt", *typed)
        self.process.start()
        wait_until(lambda: f"open {self.url}" in self.process.log.read_text(), f"{name} serves", 90)

    async def ask(self, **request: Any) -> dict[str, Any]:
        """The server's answer to a request, made without a browser."""
        async with (
            aiohttp.ClientSession() as session,
            session.ws_connect(f"{self.url}live", origin=self.url.rstrip("/")) as socket,
        ):
            at_ms = (await socket.receive_json())["at_ms"]
            await socket.send_str(json.dumps({"number": 1, "at_ms": at_ms, **request}))
            async for message in socket:
                answers = message.json().get("answers")
                if answers:
                    answer: dict[str, Any] = answers[0]
                    return answer
        raise AssertionError("the page's socket was closed")
