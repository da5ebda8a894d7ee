"""`gapmes serve`: the HTTP service in this process."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import typer

from ..errors import InputError, ModelError


def serve(
    host: Annotated[str | None, typer.Option(help="address to listen on [default: GAPMES_HOST or 127.0.0.1]")] = None,
    port: Annotated[
        int | None, typer.Option(min=0, max=65535, help="port, 0 for a free one [default: GAPMES_PORT or 8000]")
    ] = None,
    model: Annotated[Path | None, typer.Option(help="ONNX model [default: GAPMES_MODEL or the packaged one]")] = None,
    store: Annotated[Path | None, typer.Option(help="folder of the scenes [default: GAPMES_STORE]")] = None,
    threads: Annotated[int | None, typer.Option(min=1, max=1024, help="CPU threads [default: all]")] = None,
) -> None:
    """Start the service; /readyz answers 200 once the model is loaded and the kernels are warm."""
    import uvicorn
    from pydantic import ValidationError

    from ..app import create_app
    from ..settings import Settings

    given: dict[str, Any] = {"host": host, "port": port, "model": model, "store": store, "threads": threads}
    try:
        settings = Settings(**{name: value for name, value in given.items() if value is not None})
    except ValidationError as error:
        first = error.errors()[0]
        name = f"GAPMES_{'_'.join(map(str, first['loc'])).upper()}"
        raise InputError(f"{first['msg']}, got {first['input']!r}", field=name, cure="see docs/settings.md") from error
    if settings.model is not None and not settings.model.is_file():
        raise ModelError(f"{settings.model} is not a file", field="model", cure="give an .onnx of gapmes-export")
    uvicorn.run(create_app(settings), host=settings.host, port=settings.port, log_level="info")
