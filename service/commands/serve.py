"""`gapmes serve`: the HTTP service, in this process or in several that share its port and store."""

from __future__ import annotations

import contextlib
import logging
import math
import os
import signal
import sys
from collections.abc import Sequence
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from ..errors import InputError
from ..network.backends.choice import DEFAULT_ENGINE, ENGINES, checked_engine
from ..process.peers import FOLDER
from ..process.terminal import ProgressBars
from ..process.threads import MAX_THREADS
from ..progress import Stages
from .given import given, path_option

if TYPE_CHECKING:
    from ..models import Models
    from ..settings import Settings

SHARED_MEMORY = Path("/dev/shm")
ANSWER_S = 60.0  # for a worker to answer its supervisor, and after SIGHUP for its successor to be loaded
_log = logging.getLogger("gapmes")


def serve(
    host: Annotated[str | None, typer.Option(help="address to listen on [default: GAPMES_HOST or 127.0.0.1]")] = None,
    port: Annotated[
        int | None, typer.Option(min=0, max=65535, help="port, 0 for a free one [default: GAPMES_PORT or 8000]")
    ] = None,
    model: Annotated[Path | None, path_option("ONNX model [default: GAPMES_MODEL or the packaged one]")] = None,
    models: Annotated[
        str | None, typer.Option(help="further models, name=file.onnx, separated by commas [default: GAPMES_MODELS]")
    ] = None,
    engine: Annotated[
        str | None,
        typer.Option(
            help=f"engine that runs the network: {', '.join(ENGINES)} [default: GAPMES_ENGINE or onnxruntime]"
        ),
    ] = None,
    store: Annotated[Path | None, path_option("folder of the scenes [default: GAPMES_STORE]")] = None,
    threads: Annotated[
        int | None, typer.Option(min=1, max=MAX_THREADS, help="CPU threads per process [default: all]")
    ] = None,
    workers: Annotated[
        int | None, typer.Option(min=1, max=256, help="processes [default: GAPMES_WORKERS or 1]")
    ] = None,
    prepare: Annotated[
        bool, typer.Option("--prepare", help="only optimise the models for this machine, for later starts")
    ] = False,
    parent: Annotated[int | None, typer.Option(hidden=True, help="process that this one does not outlive")] = None,
    quiet: Annotated[
        bool,
        typer.Option(
            "-q", "--quiet", help="log only warnings and errors, and show no progress bars [default: GAPMES_QUIET]"
        ),
    ] = False,
) -> None:
    """Start the service; /readyz answers 200 once the model is loaded and the kernels are warm. With --prepare nothing
    starts: what the first start would do once is done."""
    os.environ.pop(FOLDER, None)  # another program's; what counts looks at it when it is imported
    import uvicorn

    from ..http.connections import BACKLOG, HEAD_S, ask_for_files
    from ..http.shutdown_deadline import GRACE_S
    from ..models import Models
    from ..process import watched_process
    from ..process.logs import configure
    from ..process.own_folder import own_folder
    from ..process.peers import OURS
    from ..process.temporary_folder import use_temporary_folder
    from ..process.with_parent import end_with_parent
    from ..scenes.store import SceneStore
    from ..settings import checked_settings, strange_variables
    from .listening import check_address

    if parent is not None:
        end_with_parent(parent)
    checked = checked_engine(engine) if engine else None
    options = given(
        host=host, port=port, model=model, models=models, engine=checked, store=store, threads=threads, workers=workers,
        quiet=quiet or None,
    )  # fmt: skip
    settings = checked_settings(**options)
    strange = strange_variables(os.environ)
    found = Models(settings)  # checks the files
    key = settings.key()
    use_temporary_folder()
    if prepare:
        _tell(strange)
        _prepare(settings, found)
        return
    SceneStore(settings.store)  # checked here once, instead of in every worker
    check_address(settings.host, settings.port, settings.workers)
    configure(settings.log, quiet=settings.quiet)
    _tell(strange)
    os.environ |= {f"GAPMES_{name.upper()}": str(value) for name, value in options.items()}  # read by the workers
    if settings.api_key_file is not None:  # it may have changed or be gone when a worker is replaced
        os.environ |= {"GAPMES_API_KEY": key or "", "GAPMES_API_KEY_FILE": ""}
    served: dict[str, Any] = {
        "factory": True,
        "host": settings.host,
        "port": settings.port,
        "workers": settings.workers,  # else it would be WEB_CONCURRENCY of the environment
        "log_config": None,
        "access_log": False,
        "server_header": False,
        "http": "gapmes.service.http.connections:Connection",
        "backlog": BACKLOG,
        "timeout_keep_alive": HEAD_S,
        "timeout_graceful_shutdown": math.ceil(settings.drain_seconds) + GRACE_S,
    }
    ask_for_files()
    signal.signal(signal.SIGTERM, _ended)  # the server raises the signal again after its shutdown
    if settings.workers == 1:
        _end_with_the_terminal()
        uvicorn.run("gapmes.service.serving:app", **served)
        return
    memory = SHARED_MEMORY if os.access(SHARED_MEMORY, os.W_OK) else None  # a full disk would kill who writes there
    with own_folder(OURS, memory) as folder:
        os.environ[FOLDER] = str(folder)
        watched_process.install()
        served["timeout_worker_healthcheck"] = round(ANSWER_S)
        uvicorn.run("gapmes.service.serving:app", **served)


def _tell(strange: Sequence[str]) -> None:
    if strange:
        _log.warning("nothing reads %s: docs/settings.md has the names of the settings", ", ".join(strange))


def _prepare(settings: Settings, models: Models) -> None:
    """Write an optimised copy of every model into the store, and compile the kernels."""
    from ..http.runtime import MODELS
    from ..kernels import warm_up_with_notice
    from ..network.backends.onnxruntime_session import session_options
    from ..network.prepared_model import prepared
    from ..process.threads import available_threads

    if settings.engine != DEFAULT_ENGINE:
        raise InputError(f"{settings.engine} keeps nothing of a model on disk", field="engine", cure=DEFAULT_ENGINE)
    folder = settings.store / MODELS
    options = partial(session_options, settings.threads or available_threads())
    with ProgressBars(quiet=settings.quiet) as bars:
        stages = Stages(bars)
        for name in models.names:
            file = models.get(name).file
            with stages.stage(f"model {name}"):
                made = prepared(file.path, file.info.file_sha256, folder, options)
            if made is None:
                raise InputError(
                    f"the model {name!r} could not be optimised into {folder}",
                    field="GAPMES_STORE",
                    cure="the line above says why",
                )
        with stages.stage("kernels"):
            warm_up_with_notice()


def _end_with_the_terminal() -> None:
    """Handle SIGHUP, of a closing terminal, like SIGTERM, unless it is ignored, as under nohup."""
    if signal.getsignal(signal.SIGHUP) != signal.SIG_IGN:
        signal.signal(signal.SIGHUP, lambda *_: os.kill(os.getpid(), signal.SIGTERM))


def _ended(*_: object) -> None:
    """Exit with code 0 at once: threads may still be inside the network, which must not be torn down then."""
    for stream in (sys.stdout, sys.stderr):
        with contextlib.suppress(OSError):  # a closed terminal, a full disk
            stream.flush()
    os._exit(0)
