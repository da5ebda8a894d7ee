"""The service's settings: one table of name, default and help, read from GAPMES_* environment variables."""

from __future__ import annotations

import os
from pathlib import Path

from pydantic import Field
from pydantic_settings import BaseSettings, SettingsConfigDict


def default_store() -> Path:
    """Scenes live with the user's other data: $XDG_DATA_HOME/gapmes/scenes, else ~/.local/share/gapmes/scenes."""
    base = os.environ.get("XDG_DATA_HOME") or Path.home() / ".local" / "share"
    return Path(base) / "gapmes" / "scenes"


class Settings(BaseSettings):
    """Every knob of the service; arguments override the environment, the environment overrides the defaults."""

    model_config = SettingsConfigDict(env_prefix="GAPMES_", frozen=True, env_ignore_empty=True)

    host: str = Field("127.0.0.1", description="address that `gapmes serve` listens on")
    port: int = Field(8000, ge=0, le=65535, description="port that `gapmes serve` listens on; 0 takes a free one")
    model: Path | None = Field(None, description="ONNX model file; empty means the `tiny` network of the package")
    store: Path = Field(default_factory=default_store, description="folder that keeps the scenes")
    threads: int | None = Field(
        None,
        ge=1,
        le=1024,
        description="CPU threads for network and splatter; empty means every core the process may use",
    )
    concurrency: int = Field(1, ge=1, le=64, description="reconstructions and renders that run at the same time")
    max_waiting: int = Field(
        16, ge=0, le=10_000, description="requests that may wait for their turn on the CPU; one more gets 503"
    )
    max_uploads: int = Field(
        8, ge=1, le=10_000, description="request bodies that are received at the same time; one more gets 503"
    )
    upload_seconds: float = Field(120.0, gt=0, description="time that a request body may take, else 408")
    max_upload_bytes: int = Field(128 * 2**20, ge=2**10, description="largest request body, in bytes")
    max_camera_bytes: int = Field(2**20, ge=2**10, description="largest `cameras` document, in bytes")
    max_image_pixels: int = Field(64_000_000, ge=32 * 32, description="largest photograph, in pixels before decoding")
    max_request_pixels: int = Field(
        192_000_000,
        ge=2 * 32 * 32,
        description="photographs of one request together, in pixels before decoding",
    )
    max_render_pixels: int = Field(8_000_000, ge=1, description="largest picture that `GET /render` draws, in pixels")
    cache_bytes: int = Field(512 * 2**20, ge=0, description="memory that keeps read scenes between renders, in bytes")
