"""`mqttxt` as a person types it."""

from __future__ import annotations

from typer.testing import CliRunner, Result

from mqttxt.cli.main import app


def typed(*words: object, said: str | None = None) -> Result:
    """What comes of a command line, where a person says `said` when asked."""
    return CliRunner().invoke(app, [*map(str, words)], input=said)


def refused(*words: object) -> str:
    """The one line that tells a person what is wrong with a command line: exit code 2, and nothing on stdout."""
    done = typed(*words)
    assert (done.exit_code, done.stdout) == (2, ""), done.output
    (line,) = done.stderr.splitlines()
    assert line.startswith("mqttxt: ")
    return line.removeprefix("mqttxt: ")
