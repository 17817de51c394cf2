"""CITATION.cff: what the Citation File Format 1.2.0 requires, and no field that it does not know."""

from __future__ import annotations

import tomllib
from pathlib import Path

import yaml

ROOT = Path(__file__).resolve().parents[3]
CITATION = yaml.safe_load((ROOT / "CITATION.cff").read_text(encoding="utf-8"))
FIELDS = {
    *("abstract", "authors", "cff-version", "commit", "contact", "date-released", "doi", "identifiers", "keywords"),
    *("license", "license-url", "message", "preferred-citation", "references", "repository", "repository-artifact"),
    *("repository-code", "title", "type", "url", "version"),
}
"""Of the format's schema (github.com/citation-file-format, schema.json of 1.2.0)."""


def test_it_has_what_the_format_requires_and_nothing_that_it_does_not_know() -> None:
    assert {"authors", "cff-version", "message", "title"} <= set(CITATION) <= FIELDS
    assert CITATION["cff-version"] == "1.2.0"
    assert CITATION["type"] in ("software", "dataset")
    assert all(isinstance(CITATION[name], str) and CITATION[name] for name in ("message", "title", "abstract"))
    assert all(isinstance(word, str) and word for word in CITATION["keywords"])
    assert len(set(CITATION["keywords"])) == len(CITATION["keywords"])
    assert [set(author) for author in CITATION["authors"]] == [{"name"}]  # an entity is named, and needs no more


def test_it_says_what_the_distribution_says() -> None:
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    assert (CITATION["license"], CITATION["version"]) == (project["license"], project["version"])
