"""The command that makes coefficients."""

import json

import pytest

from ukf_docs import coefficients


@pytest.fixture
def file(tmp_path, monkeypatch):
    """Where coefficients go."""
    file = tmp_path / "made.json"
    monkeypatch.setattr(coefficients, "FILE", file)
    return file


def test_formats_are_made_by_name(documents, file):
    result = documents("coefficients", "float7.6")
    assert f"{file}" in result.stdout.replace("\n", "")
    assert list(json.loads(file.read_text())) == ["float7.6"]


def test_formats_that_are_none_are_refused(documents, file):
    result = documents("coefficients", "float99", code=2)
    assert "format must be one of binary16" in result.stderr.replace("\n", " ")
    assert not file.exists()


def test_formats_that_have_none_leave_the_file(documents, file):
    file.write_text("{}")
    result = documents("coefficients", "float4.20", code=1)
    assert "format must be one" in result.stderr
    assert file.read_text() == "{}"
