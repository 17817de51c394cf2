"""Whether an audit log is whole: its files in order, each line chained to the one before it."""

from __future__ import annotations

import os
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field
from pathlib import Path

from ..errors import AuditBroken, ConfigurationError
from .audit_chain import BEGINNING, Line, Link
from .fleet import Fleet

LONGEST_LINE = 1_000_000
_MOST_DIGITS = 19
"""The digits of the largest number of a line, in 64 bits."""


def logs_of(files: Iterable[Path]) -> dict[Path, list[Path]]:
    """Group files by their log, each in order: FILE.NUMBER… are the older files of FILE.

    FILE itself is missing for a moment while a new one is begun. Raises ConfigurationError for an unreadable folder.
    """
    found: dict[Path, set[Path]] = {}
    for file in files:
        try:
            older = older_files(file)
        except OSError as error:
            raise ConfigurationError(f"{file.parent}: {error.strerror}; expected a folder of audit logs") from error
        log = file.with_suffix("") if _number(file) else file
        found.setdefault(log, set()).update(older if older and not file.exists() else (file, *older))
    return {log: sorted(parts, key=lambda part: (_number(part) == 0, _number(part))) for log, parts in found.items()}


def older_files(file: Path) -> list[Path]:
    """The files FILE.NUMBER beside FILE, in order; the number is that of the first line."""
    file = followed(file)
    if not file.parent.is_dir():
        return []
    return sorted((each for each in file.parent.iterdir() if each.stem == file.name and _number(each)), key=_number)


def followed(file: Path) -> Path:
    """Where a symbolic link leads: a log and its older files are there."""
    return Path(os.path.realpath(file)) if os.path.islink(file) else file


def _number(file: Path) -> int:
    digits = file.suffix[1:]
    return int(digits) if digits.isascii() and digits.isdecimal() and len(digits) <= _MOST_DIGITS else 0


@dataclass
class AuditVerdict:
    """Checks a log line by line, with the signatures of `fleet`; without a fleet they are not checked.

    `unproven` lines were not yet signed when the next session began: anyone who can write the file may have forged
    them.
    """

    fleet: Fleet | None
    lines: int = 0
    first_n: int = 0
    node: str = ""
    first_time: str = ""
    last_time: str = ""
    signed_to: str = ""
    is_revoked: bool = False
    unproven: int = 0
    torn_bytes: int = 0
    _unsigned: int = 0
    _last: Link = field(default_factory=Link)
    _last_file: Path | None = None

    def read(self, files: Iterable[Path]) -> None:
        """Check files; raises AuditBroken at the first line that was changed, ConfigurationError for other files."""
        for file in files:
            for number, line in enumerate(_lines(file), start=1):
                self._take(file, number, line)
            self._last_file = file
        if self.lines == 0:
            raise ConfigurationError(f"{self._last_file}: no line; expected an audit log")
        if self.fleet is not None and not self.signed_to:
            raise self._broken(f"{self._last_file}: no line is signed; expected signatures of fleet {self.fleet.name}")

    def _take(self, file: Path, number: int, raw: bytes) -> None:
        where = f"{file}: line {number}"
        if self.torn_bytes:
            raise self._broken(f"{self._last_file}: its last line has no end")
        if not raw.endswith(b"\n"):
            if len(raw) > LONGEST_LINE and self.lines == 0:
                raise ConfigurationError(f"{where}: longer than {LONGEST_LINE} bytes; expected an audit log")
            if len(raw) > LONGEST_LINE:
                raise self._broken(f"{where}: longer than {LONGEST_LINE} bytes")
            self.torn_bytes = len(raw)
            return
        try:
            line = Line.parse(raw[:-1])
        except ValueError as error:
            if self.lines == 0:
                raise ConfigurationError(f"{where}: {error}; expected an audit log") from None
            raise self._broken(f"{where}: {error}") from None
        if number == 1:
            self._begin(where, line)
        if not line.follows(self._last):
            raise self._broken(f"{where}: {self._unlike(line)}")
        self._note(where, line)

    def _begin(self, where: str, line: Line) -> None:
        """Check a file's first line, which names the hash before it: a log without its oldest files is a chain too."""
        before = Link(line.link.n - 1, str(line.fields.get("before")))
        if line.fields["event"] != "file":
            raise self._broken(f"{where}: not a file's first line: lines before it are missing")
        if self.lines == 0:
            if before.n == 0 and before.hash != BEGINNING:
                raise self._broken(f"{where}: a first line that names one before it")
            self._last, self.first_n = before, line.link.n
        elif before != self._last:
            raise self._broken(f"{where}: not what follows {self._last_file}: a file is missing, or one was changed")

    def _unlike(self, line: Line) -> str:
        if line.link.n > self._last.n + 1:
            return f"number {line.link.n} follows {self._last.n}: lines between them are missing"
        if line.link.n <= self._last.n:
            return f"number {line.link.n} follows {self._last.n}: lines were moved or repeated"
        return "its hash is not that of what it says: it was changed"

    def _note(self, where: str, line: Line) -> None:
        event, time = line.fields["event"], str(line.fields["time"])
        if event == "file":
            node = str(line.fields.get("node"))
            if self.lines and node != self.node:
                raise self._broken(f"{where}: of {node}; expected {self.node}, whose log it is")
            self.node = node
        elif event == "start":
            self.unproven, self._unsigned = self.unproven + self._unsigned, 0
        elif event == "head" and self.fleet is not None:
            self._check_signature(where, line, self.fleet)
            self.signed_to, self._unsigned = time, -1
        self._unsigned += event != "file"
        self.lines, self._last = self.lines + 1, line.link
        self.first_time, self.last_time = self.first_time or time, time

    def _check_signature(self, where: str, line: Line, fleet: Fleet) -> None:
        try:
            signer = self._last.signer(line.fields.get("sign1"), fleet)
        except ValueError as error:
            raise self._broken(f"{where}: {error}") from None
        if signer.name != self.node:
            raise self._broken(f"{where}: signed by {signer.name}; expected {self.node}, whose log it is")
        self.is_revoked |= signer.serial in fleet.revoked.serials

    def _broken(self, what: str) -> AuditBroken:
        return AuditBroken(f"{what}; before it {self.summary()}" if self.lines else what)

    def summary(self) -> str:
        """The number of lines, their node and time span, and who has signed them up to when."""
        parts = [f"{self.lines} lines of {self.node} are whole, {self.first_time} to {self.last_time}"]
        if self.first_n > 1:
            parts.append(f"what was before line number {self.first_n} is gone")
        if self.fleet is None:
            parts.append("signatures were not looked at (--fleet)")
        elif self.signed_to:
            revoked = ", with a certificate that is revoked" if self.is_revoked else ""
            parts.append(f"signed by {self.node} of fleet {self.fleet.name} to {self.signed_to}{revoked}")
        if self.fleet is not None and self.unproven:
            parts.append(f"{self.unproven} lines of sessions that ended without a signature")
        if self.torn_bytes:
            parts.append(f"the last line has no end ({self.torn_bytes} bytes)")
        return "; ".join(parts)


def _lines(file: Path) -> Iterator[bytes]:
    try:
        with file.open("rb") as opened:
            while line := opened.readline(LONGEST_LINE + 1):
                yield line
    except OSError as error:
        raise ConfigurationError(f"{file}: {error.strerror or error}; expected an audit log") from error
