"""The settings: read from the environment, checked, and all of them in the documentation's table."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Literal, get_args, get_origin

import pytest
from pydantic import ValidationError
from pydantic.fields import FieldInfo

from gapmes.service.errors import InputError
from gapmes.service.settings import Settings, checked_settings, default_store, strange_variables

TABLE = Path(__file__).parents[2] / "docs" / "settings.md"


def documented() -> dict[str, tuple[str, str, str]]:
    """Variable -> (default, values, meaning), as docs/settings.md has them."""
    row = r"^\| `(GAPMES_\w+)` \| (.*?) \| (.*?) \| (.*?) \|$"
    rows = re.findall(row, TABLE.read_text(encoding="utf-8"), re.MULTILINE)
    return {name: (default.strip("`"), values, meaning) for name, default, values, meaning in rows}


def values(field: FieldInfo) -> str:
    """The values that a setting may have: words, or the bounds of a number; empty for text."""
    if get_origin(field.annotation) is Literal:
        return ", ".join(f"`{word}`" for word in get_args(field.annotation))
    if field.annotation is bool:
        return "`true`, `false`"
    found = ((name, getattr(rule, name, None)) for rule in field.metadata for name in ("gt", "ge", "le"))
    bounds = {name: bound for name, bound in found if bound is not None}
    if not bounds:
        return ""
    shown = {name: f"{bound:,.0f}" if bound >= 10_000 else f"{bound:g}" for name, bound in bounds.items()}
    low = shown["ge"] if "ge" in bounds else f"above {shown['gt']}"
    return f"{low} to {shown['le']}" if "le" in bounds else f"{low} or more"


def test_every_setting_is_documented_with_its_default_values_and_meaning(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("XDG_DATA_HOME", raising=False)
    expected = {}
    for name, field in Settings.model_fields.items():
        default = field.get_default(call_default_factory=True)
        shown = "" if default is None else str(default).replace(str(Path.home()), "~")
        expected[f"GAPMES_{name.upper()}"] = (shown, values(field), field.description)
    assert documented() == expected


def test_environment_overrides_defaults_and_arguments_override_the_environment(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("GAPMES_PORT", "1234")
    monkeypatch.setenv("GAPMES_THREADS", "")
    assert Settings().port == 1234
    assert Settings().threads is None
    assert Settings(port=99).port == 99


@pytest.mark.parametrize(
    ("name", "value"), [("PORT", "70000"), ("THREADS", "0"), ("PORT", "http"), ("CONCURRENCY", "0")]
)
def test_nonsense_is_refused(monkeypatch: pytest.MonkeyPatch, name: str, value: str) -> None:
    monkeypatch.setenv(f"GAPMES_{name}", value)
    with pytest.raises(ValidationError):
        Settings()
    with pytest.raises(InputError, match=f"got {value!r}") as caught:
        checked_settings()
    assert caught.value.field == f"GAPMES_{name}"


@pytest.mark.parametrize("value", ["8000.0", "8_000", " 8000", "+8000", "8e3", "٨٠٠٠"])
def test_a_whole_number_has_plain_digits(monkeypatch: pytest.MonkeyPatch, value: str) -> None:
    """Others read the same variable, such as the health check, and know no other way to write it."""
    for name in ("PORT", "THREADS"):
        monkeypatch.setenv(f"GAPMES_{name}", value)
        with pytest.raises(InputError, match="whole number in decimal digits, got ") as caught:
            checked_settings()
        assert caught.value.field == f"GAPMES_{name}"
        monkeypatch.delenv(f"GAPMES_{name}")


def test_a_number_has_no_underscore(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("GAPMES_DRAIN_SECONDS", "1_0")
    with pytest.raises(InputError, match="number without _, got '1_0'"):
        checked_settings()
    monkeypatch.setenv("GAPMES_DRAIN_SECONDS", "1e1")
    assert checked_settings().drain_seconds == 10


FRACTIONS = [name for name, field in Settings.model_fields.items() if "float" in str(field.annotation)]


@pytest.mark.parametrize("name", FRACTIONS)
@pytest.mark.parametrize("value", ["inf", "nan", "1e12"])
def test_times_are_finite_and_no_longer_than_anybody_means(
    monkeypatch: pytest.MonkeyPatch, name: str, value: str
) -> None:
    """What waits, and what counts back from now, need not ask whether there is such a time."""
    monkeypatch.setenv(f"GAPMES_{name.upper()}", value)
    with pytest.raises(ValidationError):
        Settings()


@pytest.mark.parametrize(
    "origin",
    [
        "https://a.example",
        "http://localhost:3000",
        "http://[::1]:8080",
        "app://local",
        "null",
        "*",
        "https://a.example:80",
    ],
)
def test_origins_as_browsers_send_them_are_taken(origin: str) -> None:
    assert Settings(cors_origins=f"https://b.example, {origin}").cors_origins == f"https://b.example, {origin}"


@pytest.mark.parametrize(
    "origin",
    [
        "https://a.example/",
        "https://a.example/page",
        "a.example",
        "https://A.example",
        "https://a.example:443",
        "http://[::1]:80",
        "https://*.a.example",
        "https://ä.example",
    ],
)
def test_origins_that_no_browser_sends_are_refused(origin: str) -> None:
    """They would be allowed in vain."""
    with pytest.raises(InputError, match="no origin as browsers send it") as caught:
        Settings(cors_origins=f"https://b.example,{origin}")
    assert (caught.value.field, caught.value.index) == ("GAPMES_CORS_ORIGINS", 1)


@pytest.mark.parametrize("host", ["a.example", "LOCALHOST", "10.0.0.5", "[::1]", "my-pc_2"])
def test_names_of_hosts_are_taken(host: str) -> None:
    assert Settings(allowed_hosts=f"b.example,, {host}").allowed_hosts == f"b.example,, {host}"


@pytest.mark.parametrize(
    "host", ["a.example:8000", "https://a.example", "a.example/", "*.a.example", "::1", "[::1]:80", "ä.example", "a b"]
)
def test_what_no_request_can_name_as_its_host_is_refused(host: str) -> None:
    with pytest.raises(InputError, match="no name of a host") as caught:
        Settings(allowed_hosts=f"b.example,,{host}")
    assert (caught.value.field, caught.value.index) == ("GAPMES_ALLOWED_HOSTS", 2)


def test_store_follows_the_user_data_folder(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("XDG_DATA_HOME", "/data")
    assert default_store() == Path("/data/gapmes/scenes")


def test_a_user_without_a_home_has_to_name_the_store(monkeypatch: pytest.MonkeyPatch) -> None:
    """As a container's user that is a number alone."""

    def homeless() -> Path:
        raise RuntimeError("Could not determine home directory.")

    monkeypatch.delenv("XDG_DATA_HOME", raising=False)
    monkeypatch.setattr(Path, "home", homeless)
    with pytest.raises(InputError, match=r"is not set, and this user .* has no home folder") as refused:
        checked_settings()
    assert refused.value.field == "GAPMES_STORE"
    assert checked_settings(store=Path("/data")).store == Path("/data")


@pytest.mark.parametrize(
    ("name", "meant"), [("GAPMES_WORKER", "WORKERS"), ("GAPMES_MAX_WAITNG", "MAX_WAITING"), ("gapmes_ports", "PORT")]
)
def test_a_slip_of_the_pen_in_a_name_is_refused(name: str, meant: str) -> None:
    with pytest.raises(InputError, match=f"set GAPMES_{meant} if") as caught:
        strange_variables(["GAPMES_PORT", name])
    assert caught.value.field == name


def test_names_that_nothing_reads_are_told_apart_from_those_that_something_reads() -> None:
    """Some are set by others: for a service `gapmes-store` beside it, Kubernetes sets GAPMES_STORE_PORT."""
    elsewhere = ["GAPMES_VIEWER", "GAPMES_IMAGE", "GAPMES_PUBLISH", "GAPMES_DINOV2_REPO", "_GAPMES_COMPLETE", "PATH"]
    others = ["GAPMES_STORE_PORT", "GAPMES_STORE_SERVICE_HOST", "GAPMES_QUEUE"]
    known = [f"GAPMES_{name.upper()}" for name in Settings.model_fields]
    assert strange_variables([*known, *elsewhere, *others, "gapmes_port"]) == sorted(others)


def test_home_is_where_it_is(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """No shell reads the ~ of a file of settings."""
    monkeypatch.setenv("HOME", str(tmp_path))
    monkeypatch.setenv("GAPMES_STORE", "~/scenes")
    monkeypatch.setenv("GAPMES_MODELS", "other=~/other.onnx")
    settings = Settings()
    assert settings.store == tmp_path / "scenes"
    assert settings.model_paths()["other"] == tmp_path / "other.onnx"
    assert Settings(model=Path("~other.onnx")).model == Path("~other.onnx")  # a name that begins so


def test_a_home_that_nobody_knows_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    def unknown(_: Path) -> Path:
        raise RuntimeError("Could not determine home directory.")

    monkeypatch.setattr(Path, "expanduser", unknown)
    with pytest.raises(ValidationError, match="begins with ~, and HOME is not set"):
        Settings(store=Path("~/scenes"))
    with pytest.raises(InputError, match="begins with ~, and HOME is not set"):
        Settings(store=Path("scenes"), models="a=~/x.onnx").model_paths()
