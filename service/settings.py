"""The service's settings: one table of name, default and help, read from GAPMES_* environment variables."""

from __future__ import annotations

import os
from collections.abc import Iterable
from difflib import get_close_matches
from pathlib import Path
from typing import Any, Literal, get_args

from pydantic import Field, SecretStr, ValidationError, ValidationInfo, field_validator
from pydantic_core import PydanticCustomError
from pydantic_settings import BaseSettings, SettingsConfigDict

from .addresses import checked_hosts, checked_origins
from .errors import InputError
from .mending.detail_level import DETAILS
from .model_names import model_paths
from .network.backends.choice import DEFAULT_ENGINE, EngineName
from .process.home import at_home
from .process.threads import MAX_THREADS
from .switch import NEED, switch

PREFIX = "GAPMES_"
# Variables that begin so and are read elsewhere: by docker/compose.yaml, by setup.py, and by tests/parity.
ELSEWHERE = {
    f"{PREFIX}{name}"
    for name in ("IMAGE", "PUBLISH", "VIEWER", "DEPTHSPLAT_REPO", "DEPTH_ANYTHING_REPO", "DINOV2_REPO")
}
WEEK_S = 7 * 86_400.0  # longest time that a setting may name, but for what is kept
NEAR = 0.8  # likeness of two names, of 1, from which one is taken for a slip of the pen of the other


def default_store() -> Path:
    """Scenes live with the user's other data: $XDG_DATA_HOME/gapmes/scenes, else ~/.local/share/gapmes/scenes. Raises
    `InputError` for a user without a home folder."""
    try:
        base = Path(os.environ.get("XDG_DATA_HOME") or Path.home() / ".local" / "share")
    except RuntimeError as error:
        raise InputError(
            f"is not set, and this user (uid {os.getuid()}) has no home folder",
            field="GAPMES_STORE",
            cure="let GAPMES_STORE or --store name a folder",
        ) from error
    return base / "gapmes" / "scenes"


class Settings(BaseSettings):
    """Every knob of the service; arguments override the environment, the environment overrides the defaults."""

    model_config = SettingsConfigDict(
        env_prefix=PREFIX,
        frozen=True,
        env_ignore_empty=True,
        protected_namespaces=(),
        allow_inf_nan=False,
    )

    @field_validator("*", mode="after")
    @classmethod
    def _at_home(cls, value: Any) -> Any:
        """No shell reads `~` in a file of settings."""
        return at_home(value) if isinstance(value, Path) else value

    @field_validator("*", mode="before")
    @classmethod
    def _plain(cls, value: Any, info: ValidationInfo) -> Any:
        """Python reads 8_000 and 8000.0 as 8000; who else reads the variable, such as a health check, does not."""
        kind = cls.model_fields[info.field_name or ""].annotation
        kinds = {kind, *get_args(kind)}
        if isinstance(value, str) and int in kinds and not (value.isascii() and value.isdigit()):
            raise PydanticCustomError("plain_number", "Input should be a whole number in decimal digits")
        if isinstance(value, str) and bool in kinds and switch(value) is None:
            raise PydanticCustomError("switch", "Input should be {need}", {"need": NEED})
        if isinstance(value, str) and float in kinds and "_" in value:
            raise PydanticCustomError("plain_number", "Input should be a number without _")
        return value

    host: str = Field(
        "127.0.0.1",
        description="address that `gapmes serve` listens on; `::` includes IPv4 with several workers, not with one",
    )
    port: int = Field(8000, ge=0, le=65535, description="port that `gapmes serve` listens on; 0 takes a free one")
    model: Path | None = Field(None, description="ONNX model file; empty means the `tiny` network of the package")
    models: str = Field(
        "", description="further models that a request may name, such as `base=/models/base.onnx,small=/models/s.onnx`"
    )
    model_bytes: int | None = Field(
        None,
        ge=1,
        description="size of the loaded models (their files, graph and weights) beyond which those go that were used"
        " longest ago; empty means no limit",
    )
    engine: EngineName = Field(
        DEFAULT_ENGINE,
        description="what computes the networks",
    )
    store: Path = Field(default_factory=default_store, description="folder that keeps the scenes")
    threads: int | None = Field(
        None,
        ge=1,
        le=MAX_THREADS,
        description="CPU threads for network and splatter; empty means all cores, or the container's share of them",
    )
    workers: int = Field(1, ge=1, le=256, description="processes that share the port and the store")
    concurrency: int = Field(1, ge=1, le=64, description="reconstructions that a process computes at the same time")
    max_waiting: int = Field(
        16, ge=0, le=10_000, description="reconstructions of the whole store that may wait; one more gets 503"
    )
    reconstruct_seconds: float = Field(
        600.0,
        gt=0,
        le=WEEK_S,
        description="time that a reconstruction may take once it runs, its wait for a model included, else 504",
    )
    wait_seconds: float = Field(
        900.0,
        gt=0,
        le=WEEK_S,
        description="time that `POST /reconstruct` waits for its scene, else 504; a job has no such limit",
    )
    job_keep_seconds: float = Field(
        86_400.0, ge=60, le=520 * WEEK_S, description="time after which a job that ended is forgotten"
    )
    max_streams: int = Field(
        64, ge=1, le=10_000, description="clients that follow jobs at the same time; one more gets 503"
    )
    heartbeat_seconds: float = Field(
        15.0, gt=0, le=WEEK_S, description="time between two signs of life on a stream of events"
    )
    render_concurrency: int = Field(1, ge=1, le=64, description="pictures that a process draws at the same time")
    render_waiting: int = Field(
        32, ge=0, le=10_000, description="pictures that may wait in a process; one more gets 503"
    )
    render_seconds: float = Field(
        30.0, gt=0, le=WEEK_S, description="time that a picture may wait for its turn, else 503"
    )
    picture_seconds: float = Field(
        60.0, gt=0, le=WEEK_S, description="time that a picture may take to be drawn, else 504"
    )
    drain_seconds: float = Field(
        20.0,
        ge=0,
        le=WEEK_S,
        description="time that requests and jobs have to end after SIGTERM; longer ones are left to others",
    )
    api_key: SecretStr | None = Field(
        None,
        description="key that requests must bring as `Authorization: Bearer` or `X-API-Key`, of printable ASCII; empty"
        " means that none is needed",
    )
    api_key_file: Path | None = Field(
        None, description="file with that key, such as a mounted secret, in its place; read once, at the start"
    )
    cors_origins: str = Field(
        "", description="origins, comma separated, whose pages may call the service; empty means none, `*` all"
    )
    allowed_hosts: str = Field(
        "", description="names, comma separated, by which requests may call the service; empty means any"
    )
    log: Literal["text", "json"] = Field("text", description="form of the log on stderr, a line per event")
    quiet: bool = Field(
        False, description="log only warnings and errors, and show no progress bars when the service starts"
    )
    store_bytes: int | None = Field(
        None,
        ge=1,
        description="size of the store beyond which the scenes go that were read longest ago; empty means no limit",
    )
    store_days: float | None = Field(
        None, gt=0, le=36_500, description="days after which a scene goes that nobody has read"
    )
    max_uploads: int = Field(
        8, ge=1, le=10_000, description="request bodies that are received at the same time; one more gets 503"
    )
    upload_seconds: float = Field(120.0, gt=0, le=WEEK_S, description="time that a request body may take, else 408")
    max_upload_bytes: int = Field(128 * 2**20, ge=2**10, description="largest request body, in bytes")
    max_uploads_bytes: int = Field(
        512 * 2**20,
        ge=2**10,
        description="request bodies in the memory of a process together, in bytes; what goes beyond gets 503; a"
        " body that is alone may be larger",
    )
    max_camera_bytes: int = Field(
        2**20, ge=2**10, description="largest `cameras` document, in bytes; in a zip four times as much"
    )
    max_gaussians: int = Field(2_000_000, ge=1, description="Gaussians of a file that `POST /scenes` loads, at most")
    max_detail: int = Field(
        max(DETAILS),
        ge=1,
        le=max(DETAILS),
        description="`detail` that a request may ask for, at most; six photographs with 2 take 1.9 GB, of 16 : 9 3.0",
    )
    max_image_pixels: int = Field(64_000_000, ge=32 * 32, description="largest photograph, in pixels before decoding")
    max_request_pixels: int = Field(
        192_000_000,
        ge=2 * 32 * 32,
        description="photographs of one request together, in pixels before decoding",
    )
    max_render_pixels: int = Field(
        8_000_000,
        ge=1,
        description="largest picture of `GET /render`, in pixels times `samples` squared; or film or sheet",
    )
    cache_bytes: int = Field(512 * 2**20, ge=0, description="memory that keeps read scenes between renders, in bytes")

    @field_validator("cors_origins")
    @classmethod
    def _origins(cls, origins: str) -> str:
        return checked_origins(origins)

    @field_validator("allowed_hosts")
    @classmethod
    def _hosts(cls, hosts: str) -> str:
        return checked_hosts(hosts)

    def model_paths(self) -> dict[str, Path]:
        """Name -> file of every model, the default one first. Raises `InputError` where GAPMES_MODELS is malformed."""
        return model_paths(self.model, self.models)

    def key(self) -> str | None:
        """The API key, from its file where one is named. Raises `InputError` where it cannot be read or is empty, where
        no request could bring it, or where both settings have one."""
        if self.api_key is not None and self.api_key_file is not None:
            raise InputError(
                "is set, and so is GAPMES_API_KEY_FILE; need one of them",
                field="GAPMES_API_KEY",
                cure="unset GAPMES_API_KEY or GAPMES_API_KEY_FILE",
            )
        if self.api_key_file is not None:
            try:
                key = self.api_key_file.read_bytes().strip().decode("latin-1")  # so that each byte has an index
            except OSError as error:
                raise InputError(
                    f"{self.api_key_file} cannot be read: {error.strerror}",
                    field="GAPMES_API_KEY_FILE",
                    cure=f"name a file that the service, as uid {os.getuid()}, may read",
                ) from error
            if not key:
                raise InputError("the file is empty", field="GAPMES_API_KEY_FILE", cure="write the key into it")
            return _sendable(key, "GAPMES_API_KEY_FILE")
        if self.api_key is None:
            return None
        key = self.api_key.get_secret_value()
        if not key:
            raise InputError("is empty", field="GAPMES_API_KEY", cure="leave it out where none is needed")
        return _sendable(key, "GAPMES_API_KEY")


def checked_settings(**given: Any) -> Settings:
    """The settings, with `given` in the place of the environment. Raises `InputError` for the first that is refused."""
    try:
        return Settings(**given)
    except ValidationError as error:
        first = error.errors()[0]
        name = f"{PREFIX}{'_'.join(map(str, first['loc'])).upper()}"
        raise InputError(f"{first['msg']}, got {first['input']!r}", field=name, cure="see docs/settings.md") from error


def _sendable(key: str, field: str) -> str:
    """The key. Raises `InputError` where it is none that the header of a request can hold, and does not tell it."""
    strange = next((index for index, letter in enumerate(key) if not " " <= letter <= "~"), None)
    if strange is not None:
        raise InputError(
            f"the key's character {strange}, counted from 0, is not printable ASCII, which every request could send",
            field=field,
            index=strange,
            cure="take a key of ASCII letters, digits and signs",
        )
    if key != key.strip():
        raise InputError(
            "the key begins or ends with a space, which a request's header loses",
            field=field,
            cure="remove the spaces around it",
        )
    return key


def strange_variables(names: Iterable[str]) -> list[str]:
    """Those of `names`, of variables of the environment, that begin as a setting's and that nothing reads. Raises
    `InputError` where one is nearly that of a setting."""
    known = {name.upper() for name in Settings.model_fields}
    strange = [name for name in sorted(names) if name.upper().startswith(PREFIX) and name.upper() not in ELSEWHERE]
    strange = [name for name in strange if name.upper().removeprefix(PREFIX) not in known]
    for name in strange:
        near = get_close_matches(name.upper().removeprefix(PREFIX), sorted(known), n=1, cutoff=NEAR)
        if near:
            raise InputError("is no setting", field=name, cure=f"set {PREFIX}{near[0]} if that is meant, or unset it")
    return strange
