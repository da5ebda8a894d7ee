"""The configured models: inspected when the service starts, loaded when one is first used, kept within a budget."""

from __future__ import annotations

from contextlib import AbstractContextManager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from .errors import ModelError
from .model_names import DEFAULT, checked_name
from .model_pool import Pool
from .network.backends.choice import EngineName, MadeBy, identity, made_by
from .network.model_file import ModelFile, model_file, sha256_of
from .settings import Settings

if TYPE_CHECKING:
    from .reconstruct import Reconstructor


@dataclass(frozen=True)
class Configured:
    """A model under the name that the service has for it."""

    name: str
    file: ModelFile
    engine: EngineName

    @property
    def identity(self) -> str:
        """What its scenes depend on: file and engine, not the name."""
        return identity(self.file.info.file_sha256, self.engine)


class Models:
    """Every model of a service, by name; safe for threads."""

    def __init__(self, settings: Settings, *, prepare: Path | None = None) -> None:
        """Look at the files, and load none. Raises `ModelError` for one that is missing or not ours, or that alone is
        larger than the budget, and `InputError` where GAPMES_MODELS is malformed."""
        self._settings, self._prepare = settings, prepare
        self.made_by: MadeBy = made_by(settings.engine)
        self._known = {
            name: Configured(name, _inspected(name, path), settings.engine)
            for name, path in settings.model_paths().items()
        }
        sizes = {name: model.file.bytes for name, model in self._known.items()}
        for name, size in sizes.items():
            if settings.model_bytes is not None and size > settings.model_bytes:
                raise ModelError(
                    f"the model {name!r} has {size} bytes, the budget is {settings.model_bytes}",
                    field="GAPMES_MODEL_BYTES",
                    cure="raise it, or leave the model out",
                )
        self._pool: Pool[Reconstructor] = Pool(self._load, sizes, settings.model_bytes)

    @property
    def names(self) -> tuple[str, ...]:
        """The default one first."""
        return tuple(self._known)

    def get(self, name: str) -> Configured:
        """Raises `ModelUnknown`."""
        return self._known[checked_name(name, self._known)]

    def loaded(self, name: str) -> bool:
        """Whether it is in memory."""
        return self._pool.loaded(self.get(name).name)

    def using(self, name: str) -> AbstractContextManager[Reconstructor]:
        """The model, loaded where it is not, for as long as the block lasts; waits while the budget is taken by models
        that are in use. Raises `ModelError` where it cannot be loaded, before another goes for it where its files tell
        that."""
        model = self.get(name)
        if not self._pool.loaded(model.name):
            _require_unchanged(model.file)
        return self._pool.using(model.name)

    def summary(self, name: str) -> dict[str, Any]:
        """A model as the service tells of it."""
        model = self.get(name)
        return {
            "name": name,
            **model.file.info.document(),
            "engine": self.made_by.document(),
            "bytes": model.file.bytes,
            "loaded": self.loaded(name),
        }

    def document(self) -> dict[str, Any]:
        """All of them, and the budget."""
        return {
            "models": [self.summary(name) for name in self._known],
            "default": DEFAULT,
            "loaded_bytes": self._pool.used_bytes(),
            "budget_bytes": self._settings.model_bytes,
        }

    def _load(self, name: str) -> Reconstructor:
        from .reconstruct import Reconstructor

        file = self._known[name].file
        _require_unchanged(file)  # it may have waited for its turn
        return Reconstructor(
            file.path,
            threads=self._settings.threads,
            prepare=self._prepare,
            engine=self._settings.engine,
        )


def _require_unchanged(file: ModelFile) -> None:
    """Raises `ModelError` where it is not what it was: its scenes would have the name of that."""
    found = sha256_of(file.path)
    if found != file.info.file_sha256:
        raise ModelError(
            f"{file.path} has the sha256 {found}, it had {file.info.file_sha256} when the service started",
            field="model",
            cure="restart the service",
        )
    if file.weights is not None:
        file.weights.check()


def _inspected(name: str, path: Path) -> ModelFile:
    """The file of a model; an error names the model too, where it is not the default one."""
    try:
        return model_file(path)
    except ModelError as error:
        if name == DEFAULT:
            raise
        raise ModelError(f"{name}: {error.message}", field="GAPMES_MODELS", cure=error.cure) from error
