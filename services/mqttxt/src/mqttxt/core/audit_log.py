"""The audit log of a role: who commanded what, when, with which last word (docs/protocol.md, section 14).

A thread of its own writes and syncs. The role's event loop only puts records into a queue, so that no command waits
for this log. Records that cannot be written wait in memory. That queue is bounded; records beyond it are counted.
"""

from __future__ import annotations

import json
import logging
import threading
import time
from collections import deque
from pathlib import Path
from typing import Any

from ..errors import ConfigurationError
from ..protocol.codec import encode
from ..protocol.values import Encoding
from ..security.identity import Identity
from ..security.seal import Seal
from .audit_file import AuditFile
from .disk import is_fault
from .effects import Audit

logger = logging.getLogger("mqttxt.audit")

WRITE_S = 0.2
"""Pause of the thread between two looks at the queue: to wake it for each record would cost the event loop 0.1 ms."""
SYNC_S = 1.0
"""Time between two syncs; a power loss costs the lines since the last one. It is not shorter because the UAV client's
journal is on the same disk, and the sync of one file may wait for that of another."""
SIGN_S = 60.0
RETRY_S = 1.0
MOST_WAITING = 10_000
"""Most records that wait for the disk; further ones are counted. A flood makes fewer between two looks."""
CLOSING_S = 2.0


class AuditLog:
    """The log of one session of a node, signed if the node has an identity.

    A full or failing disk does not end the role. If the log is `required`, the role refuses commands meanwhile: see
    `takes`. Raises ConfigurationError for an unusable path, a file that is no audit log, or another process's log.
    """

    def __init__(self, path: Path, node: str, identity: Identity | None = None, required: bool = False) -> None:
        self.required = required
        self._file = AuditFile(path, node)
        self._session = 0
        self._seal = Seal(identity) if identity is not None else None
        self._now_s = identity.time.now_s if identity is not None else time.time
        self._waiting: deque[tuple[float, Audit]] = deque()
        self._lost = self._lost_told = 0
        self._closing = threading.Event()
        self._is_started = False
        self._thread = threading.Thread(target=self._run, name="mqttxt-audit", daemon=True)
        self._failed_at_s: float | None = None
        self._failure = ""
        self._next_sync_s = self._next_sign_s = 0.0
        self._is_signed = True
        if path.suffix[1:].isdecimal():
            raise ConfigurationError(f"--audit {path}: expected no .NUMBER at its end, as older files have")
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            self._file.open(self._now_s())
        except BlockingIOError:
            raise ConfigurationError(f"--audit {path}: another process has it; expected one for each role") from None
        except OSError as error:
            if not is_fault(error):
                raise ConfigurationError(
                    f"--audit {path}: cannot be written: {error.strerror}; expected a file"
                ) from error
            self._fail(error)
        if self._seal is None:
            logger.warning("audit log %s: not signed without `identity`: who can write the file can change it", path)

    def takes(self) -> bool:
        """Whether a record made now would be kept: the last write succeeded, and the queue is less than half full."""
        return self._failed_at_s is None and len(self._waiting) < MOST_WAITING // 2

    def start(self, session: int) -> None:
        """Start the thread, which writes the records of `session`."""
        self._session = session
        self._thread.start()

    def record(self, effect: Audit) -> None:
        """Queue a record, without waiting for the disk or the thread; count it as lost if the queue is full."""
        if len(self._waiting) < MOST_WAITING:
            self._waiting.append((self._now_s(), effect))
        else:
            self._lost += 1

    def close(self) -> None:
        """Write the queue, sign, and end the thread; blocks for at most two seconds, as a disk may never answer."""
        self._closing.set()
        self._thread.join(CLOSING_S)

    def _run(self) -> None:
        is_last = False
        while not is_last:
            try:
                self._turn(is_last := self._closing.is_set())
            except OSError as error:
                self._fail(error)
            self._closing.wait(WRITE_S if self._failed_at_s is None else RETRY_S)
        self._file.fail()

    def _turn(self, is_last: bool) -> None:
        """Write, sign and sync what is due; raises OSError, after which nothing is lost."""
        self._file.open(self._now_s())
        if self._failed_at_s is not None:
            self._file.flush()
        lost = self._add(is_last)
        now_s = time.monotonic()
        if self._seal is not None and not self._is_signed and (is_last or now_s >= self._next_sign_s):
            self._file.sign(self._now_s(), self._seal)
            self._is_signed, self._next_sign_s = True, now_s + SIGN_S
        self._file.flush()
        if lost is not None:
            logger.warning("audit log %s: can be written again; %d records are lost", self._file.path, lost)
        if not self._file.is_synced and (is_last or now_s >= self._next_sync_s):
            self._file.sync(self._now_s())
            self._next_sync_s = now_s + SYNC_S

    def _add(self, is_last: bool) -> int | None:
        """Chain the records since the last turn; returns the number of lost ones if there is a gap, else None."""
        if not self._is_started:
            self._is_started = True
            self._line("start", {"session": self._session, "signed": self._seal is not None})
        lost = self._lost - self._lost_told
        for _ in range(len(self._waiting)):
            time_s, record = self._waiting.popleft()
            self._line(record.event, _fields(record), time_s)
        is_gap, since_s = lost > 0 or self._failed_at_s is not None, self._failed_at_s
        if is_gap:
            why = {"disk": self._failure, "seconds": round(self._now_s() - since_s, 1)} if since_s is not None else {}
            self._line("gap", {"lost": lost, **why})
            self._failed_at_s, self._lost_told = None, self._lost_told + lost
        if is_last:
            self._line("end", {})
        return lost if is_gap else None

    def _line(self, event: str, fields: dict[str, Any], time_s: float | None = None) -> None:
        self._file.add(self._now_s() if time_s is None else time_s, event, fields)
        self._is_signed = False

    def _fail(self, error: OSError) -> None:
        """Note a write error, and log it once until lines can be written again."""
        self._file.fail()
        if self._failed_at_s is None:
            self._failed_at_s, self._failure = self._now_s(), error.strerror or str(error)
            meanwhile = "commands are denied" if self.required else "records wait in memory"
            logger.error("audit log %s: %s; %s until it can be written", self._file.path, self._failure, meanwhile)


def _fields(record: Audit) -> dict[str, Any]:
    said = json.loads(encode(record.message, Encoding.JSON))
    return {"ms": record.now_ms, "who": record.who, "signed": record.is_signed, "drone": record.drone, "said": said}
