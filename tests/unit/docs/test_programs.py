"""The programs that write the documents' tables, pictures and schemas: what is not there is named in one line."""

from __future__ import annotations

from collections.abc import Callable
from itertools import product

import pytest

from spec import brokers, flights, options, pictures, scale, schema, tables
from testbed.plan.documents import ROOT

A_PAGE = "no such file; expected the path of a page under docs"
A_SERIES = "no such file; expected a series, a folder with metrics.json"
MISSING = [
    *((program.main, name, A_PAGE) for program, name in product((brokers, options, scale, tables), ("--help", "docs"))),
    (scale.main, "README.md", A_PAGE),
    (flights.main, "docs", A_SERIES),
    (pictures.main, "README.md", "no such folder"),
    (schema.main, "missing", "no such folder"),
]


@pytest.mark.parametrize(("main", "name", "expected"), MISSING)
def test_what_is_missing_is_one_line(
    main: Callable[[str], None],
    name: str,
    expected: str,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.chdir(ROOT)
    with pytest.raises(SystemExit) as ended:
        main(name)
    assert ended.value.code == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert line.startswith(name.removesuffix(".md"))
    assert line.endswith(expected)
