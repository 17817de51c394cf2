"""A series that is pushed is in the campaign's folder whole, or not at all, and once."""

from __future__ import annotations

import os
from dataclasses import replace
from pathlib import Path

import pytest

from testbed.errors import ResultsError
from testbed.fly.campaign import pushing
from testbed.fly.campaign.pushing import INCOMING, ArrivedSeries, File, Store, files_of, push, remove
from testbed.fly.results import Series

NAME = "scenario 3, arm thesis, profile ideal"
PATH = "scenario-3/thesis-ideal/20260101T000000Z"


@pytest.fixture(autouse=True)
def _small_parts(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(pushing, "CHUNK", 1000)


def series_in(root: Path, text: bytes = b"flown") -> Series:
    """With a file of several parts, an empty one, and a link."""
    series = Series(root / PATH)
    attempt = series.path / "mqttxt" / "attempt-01"
    attempt.mkdir(parents=True)
    (attempt / "manifest.json").write_bytes(text)
    (attempt / "gs.pcap").write_bytes(os.urandom(2500))
    (attempt / "events.jsonl").touch()
    (series.path / "latest").symlink_to(attempt)
    return series


def pushed(store: Store, root: Path, machine: str = "lab-1") -> ArrivedSeries:
    return push(Series(root / PATH), root, NAME, machine, ["attempt 1: void"], store)


def begun(folder: Path) -> tuple[Store, str, dict[str, bytes]]:
    """A store to which a series is announced, the token of that, and what is to be put there."""
    series, store = series_in(folder / "worker"), Store(folder / "results")
    files = files_of(series.path)
    return store, store.begin(PATH, files), {file.path: (series.path / file.path).read_bytes() for file in files}


def left_in(root: Path) -> list[str]:
    """What there is besides the series that was asked for."""
    return [path.name for path in root.glob(f"{INCOMING}/*")] + [path.name for path in root.glob("scenario-*/*/2*")]


def test_a_series_arrives_as_it_was_flown(tmp_path: Path) -> None:
    series = series_in(tmp_path / "worker")
    store = Store(tmp_path / "results")
    arrived = pushed(store, tmp_path / "worker")
    assert arrived == ArrivedSeries(PATH, "lab-1", 3, 2505, ("attempt 1: void",))
    assert files_of(tmp_path / "results" / PATH) == files_of(series.path)
    assert (tmp_path / "results" / "scenario-3" / "latest").resolve().name == "20260101T000000Z"
    assert left_in(tmp_path / "results") == ["20260101T000000Z"]
    assert store.there(NAME) == arrived
    remove(series, tmp_path / "worker")
    assert not list((tmp_path / "worker").glob("*/*/*"))


def test_the_same_part_twice_is_the_same_as_once(tmp_path: Path) -> None:
    store, token, contents = begun(tmp_path)
    for path, data in contents.items():
        for offset in (1000, 0, 2000, 1000):
            if offset < len(data):
                store.put(token, path, offset, data[offset : offset + 1000])
    assert store.finish(token, NAME, "lab-1", ()).size == 2505


def test_the_first_series_of_a_name_counts_and_a_second_one_is_dropped(tmp_path: Path) -> None:
    series_in(tmp_path / "given up", b"late")
    series_in(tmp_path / "again", b"again")
    store = Store(tmp_path / "results")
    first = pushed(store, tmp_path / "again", "lab-2")
    assert pushed(store, tmp_path / "given up", "lab-1") == first
    assert left_in(tmp_path / "results") == ["20260101T000000Z"]
    assert (tmp_path / "results" / PATH / "mqttxt/attempt-01/manifest.json").read_bytes() == b"again"


@pytest.mark.parametrize("harm", ["a part is missing", "a byte is another", "a file is missing"])
def test_a_series_that_is_not_whole_is_not_there_at_all(tmp_path: Path, harm: str) -> None:
    store, token, contents = begun(tmp_path)
    for path, data in contents.items():
        if path.endswith("gs.pcap"):
            if harm == "a file is missing":
                continue
            data = data[:2000] if harm == "a part is missing" else bytes([data[0] ^ 1]) + data[1:]
        if data:
            store.put(token, path, 0, data)
    with pytest.raises(ResultsError, match=r"pushed: mqttxt/attempt-01/gs\.pcap: not whole: expected 2500 bytes"):
        store.finish(token, NAME, "lab-1", ())
    assert left_in(tmp_path / "results") == []
    assert store.there(NAME) is None
    assert pushed(store, tmp_path / "worker").series == PATH


def test_what_was_not_announced_is_refused(tmp_path: Path) -> None:
    store = Store(tmp_path)
    token = store.begin(PATH, (File("a", 3, ""),))
    for path, offset, data in (("b", 0, b"x"), ("a", 0, b"four"), ("a", 2, b"xy")):
        with pytest.raises(ResultsError, match="not in what was announced"):
            store.put(token, path, offset, data)


@pytest.mark.parametrize("path", ["../a", "/a", "", "b/../../a"])
def test_no_file_is_written_outside_of_its_series(tmp_path: Path, path: str) -> None:
    with pytest.raises(ResultsError, match="expected a path below the series' folder"):
        Store(tmp_path).begin(PATH, (File(path, 1, ""),))


@pytest.mark.parametrize(
    "series", ["", "x", "a/x", "/a/b/x", "a/b/../x", "../a/x", "a/latest/x", ".incoming/1/x", "a/b/c/x"]
)
def test_a_series_is_put_where_series_are_and_nowhere_else(tmp_path: Path, series: str) -> None:
    """Beside it stands `latest`: of a series at the top of the results folder it would be outside of it."""
    (tmp_path / "latest").write_text("mine")
    store = Store(tmp_path / "results")
    with pytest.raises(ResultsError, match="expected EXPERIMENT/ARM-PROFILE/TIME"):
        store.finish(store.begin(series, ()), NAME, "lab-1", ())
    assert (tmp_path / "latest").read_text() == "mine"


def test_series_that_began_in_the_same_second_do_not_meet(tmp_path: Path) -> None:
    series_in(tmp_path / "worker")
    series_in(tmp_path / "results")
    assert pushed(Store(tmp_path / "results"), tmp_path / "worker").series == f"{PATH}-2"


def test_what_a_campaign_that_was_broken_off_left_goes(tmp_path: Path) -> None:
    store = Store(tmp_path)
    store.put(store.begin(PATH, (File("a", 3, ""),)), "a", 0, b"abc")
    assert left_in(tmp_path) == ["1"]
    Store(tmp_path)
    assert left_in(tmp_path) == []


def test_a_file_that_grows_while_it_is_pushed_is_not_whole(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    series_in(tmp_path / "worker")
    known = files_of
    monkeypatch.setattr(pushing, "files_of", lambda path: tuple(replace(f, size=f.size + 1) for f in known(path)))
    with pytest.raises(ResultsError, match="not whole"):
        pushed(Store(tmp_path / "results"), tmp_path / "worker")
    assert left_in(tmp_path / "results") == []
