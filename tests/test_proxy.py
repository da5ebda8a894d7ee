"""The refusals of the proxy in front of several replicas have the form of the service's own, and its settings are
documented."""

from __future__ import annotations

import json
import re
from pathlib import Path

from gapmes.service.errors import GapmesError
from gapmes.service.http.problems import FRAMEWORK_CODES
from gapmes.service.http.render import RenderQuery
from gapmes.service.problem_document import of_error, problem

ROOT = Path(__file__).parent.parent
CONF = (ROOT / "docker" / "nginx.conf").read_text()


def errors(kind: type[GapmesError] = GapmesError) -> dict[str, type[GapmesError]]:
    return {kind.code: kind} | {code: each for some in kind.__subclasses__() for code, each in errors(some).items()}


def test_its_refusals_are_problem_documents_of_the_service() -> None:
    answers = re.findall(
        r"location (?:= )?(@\w+|/[\w-]+) \{[^}]*?default_type ([\w/+]+);[^}]*?return (\d+) '(\{[^']*\})';",
        CONF,
        re.DOTALL,
    )
    assert sorted(name for name, *_ in answers) == sorted(set(re.findall(r"error_page [\d ]+ = ([@/][\w-]+);", CONF)))
    assert len(answers) == 4
    for _, media_type, status, body in answers:
        document = json.loads(body)
        told = {"detail": document["detail"], "cure": document["cure"]}
        if (own := errors().get(document["code"])) is not None:
            assert document == of_error(own(told["detail"], cure=told["cure"]))
        else:  # one of the framework's
            code = FRAMEWORK_CODES.get(document["status"], f"http_{document['status']}")
            assert document == problem(document["status"], code, **told)
        assert int(status) == document["status"]
        assert media_type == "application/problem+json"


def test_it_takes_what_the_service_takes() -> None:
    """A little more, so that the service says what is too large, with its own limit."""
    from gapmes.service.settings import Settings

    (megabytes,) = map(int, re.findall(r"client_max_body_size (\d+)m;", CONF))
    most = Settings.model_fields["max_upload_bytes"].default
    assert most < megabytes * 2**20 < 1.05 * most
    assert f"more than {megabytes} MiB" in CONF


def test_it_passes_on_what_a_query_may_hold() -> None:
    """Every character of a camera counts as three."""
    (kilobytes,) = map(int, re.findall(r"large_client_header_buffers \d+ (\d+)k;", CONF))
    query = RenderQuery.model_json_schema()["properties"]["camera"]["anyOf"][0]
    assert 3 * query["maxLength"] < kilobytes * 2**10
    assert f"more than {kilobytes} KiB" in CONF


def test_what_the_replicas_and_the_proxy_read_is_documented_with_its_default() -> None:
    read = dict(re.findall(r"\$\{(\w+):-([^}]*)\}", (ROOT / "docker" / "compose.yaml").read_text()))
    page = (ROOT / "docs" / "operations.md").read_text(encoding="utf-8")
    documented = {
        name: default.strip("`").replace("none", "")
        for names, default in re.findall(r"^\| ((?:`[A-Z_]+`(?:, )?)+) \| (.*?) \|", page, re.MULTILINE)
        for name in re.findall(r"`(\w+)`", names)
    }
    assert documented == read
