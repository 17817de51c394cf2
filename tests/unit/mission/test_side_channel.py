"""The control socket: one line out, one line in, and a reason where nobody answers as the stand-in does."""

from __future__ import annotations

import asyncio
import json
from pathlib import Path

import pytest

from mission import side_channel
from mission.fleet import MissionError
from mission.side_channel import SideChannel


async def _ask(tmp_path: Path, answer: bytes | None) -> tuple[object, list[object]]:
    """The answer to a request, and the requests that came; None: the other side ends without a word."""
    asked: list[object] = []

    async def serve(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        asked.append(json.loads(await reader.readline()))
        if answer is not None:
            writer.write(answer)
            await writer.drain()
        if answer != b"":
            writer.close()

    path = tmp_path / "c.sock"
    async with await asyncio.start_unix_server(serve, str(path)), SideChannel(path) as channel:
        return await channel.set(armed=True, altitude_m=10), asked


async def test_what_is_set_is_answered_with_the_true_state(tmp_path: Path) -> None:
    assert await _ask(tmp_path, b'{"armed": true}\n') == ({"armed": True}, [{"set": {"armed": True, "altitude_m": 10}}])


@pytest.mark.parametrize(
    ("answer", "said"),
    [
        (b'{"error": "set colour: expected one of mode"}\n', "set colour: expected one of mode"),
        (None, "the autopilot has ended"),
        (b"", "no answer within 0.05 s"),
    ],
)
async def test_what_goes_wrong_is_the_missions_reason(
    answer: bytes | None, said: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    if answer == b"":
        monkeypatch.setattr(side_channel, "ANSWER_LIMIT_S", 0.05)
    with pytest.raises(MissionError) as error:
        await _ask(tmp_path, answer)
    assert str(error.value) == f"control socket {tmp_path / 'c.sock'}: {said}"


async def test_an_autopilot_without_a_control_socket_is_named(tmp_path: Path) -> None:
    with pytest.raises(MissionError, match=r"control socket .*none\.sock: No such file or directory"):
        await SideChannel(tmp_path / "none.sock").__aenter__()
