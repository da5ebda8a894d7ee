"""From what a user names (a file, a folder, a name on the Hugging Face hub) to the one weights file that is meant."""

from __future__ import annotations

import json
import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

from ..weights_file import CheckpointError
from .files import INDEX, SAFETENSORS, TORCH, shard_names

PREFERRED = ("model.safetensors", "model" + INDEX, "pytorch_model.bin")
CONFIG = "config.json"
_HUB_NAME = re.compile(r"(?P<repository>[A-Za-z0-9][\w.-]*/[A-Za-z0-9][\w.-]*)(?:@(?P<revision>[\w./-]+))?")


@dataclass(frozen=True)
class Source:
    """Where weights come from; the hub's fields are empty for what lies on this machine."""

    given: str  # as the user wrote it
    path: Path  # the weights file, or the index of a sharded one
    config: Path | None  # the configuration published beside it
    repository: str = ""
    commit: str = ""  # of the hub's repository: the same name later may mean other weights


def resolve(source: str | Path, *, cache: Path | None = None) -> Source:
    """The file that `source` names: an existing file, a folder, or `owner/name` or `owner/name@revision` on the hub.

    Of a folder or a repository the safetensors file is preferred, then its shards, then `pytorch_model.bin`, then the
    only file in torch's format. `cache` replaces the hub's own folder of downloads. A `Path` is never looked up on the
    hub. Raises `CheckpointError` when nothing or more than one thing is meant, or when the hub cannot give it.
    """
    path = Path(source).expanduser()
    if path.is_file():
        return Source(str(source), path, _beside(path))
    if path.is_dir():
        chosen = choose(path)
        return Source(str(source), chosen, _beside(chosen))
    name = _HUB_NAME.fullmatch(source) if isinstance(source, str) else None
    if name is None or path.suffix in (SAFETENSORS, *TORCH):
        raise CheckpointError(
            f"{source}: no such file or folder, and no name on the hub either (owner/name or owner/name@revision)"
        )
    return _from_hub(str(source), name["repository"], name["revision"], cache)


def choose(folder: Path) -> Path:
    """The weights file of a folder; raises `CheckpointError` that lists what is there when it is not clear."""
    for name in PREFERRED:
        if (folder / name).is_file():
            return folder / name
    return folder / _only(str(folder), sorted(p.name for p in folder.iterdir() if p.is_file()))


def _only(place: str, names: Sequence[str]) -> str:
    """The one weights file among the names of files."""
    weights = [name for name in names if Path(name).suffix in (SAFETENSORS, *TORCH)]
    if len(weights) == 1:
        return weights[0]
    listed = ", ".join(weights or names) or "nothing"
    wrong = "more than one weights file" if weights else "no weights file"
    raise CheckpointError(f"{place} holds {wrong} ({listed}); name the file, or leave one of {', '.join(PREFERRED)}")


def _beside(path: Path) -> Path | None:
    config = path.parent / CONFIG
    return config if config.is_file() else None


def _from_hub(given: str, repository: str, revision: str | None, cache: Path | None) -> Source:
    # Imported here: it takes a while, and a local file needs none of it.
    from huggingface_hub import hf_hub_download, list_repo_files, snapshot_download
    from huggingface_hub.errors import (
        EntryNotFoundError,
        HfHubHTTPError,
        HFValidationError,
        LocalEntryNotFoundError,
        RepositoryNotFoundError,
        RevisionNotFoundError,
    )

    offline = False

    def file(name: str) -> Path | None:
        """The file in the cache, downloaded where needed, or None where the repository has none of that name."""
        nonlocal offline
        try:
            return Path(hf_hub_download(repository, name, revision=revision, cache_dir=cache, local_files_only=offline))
        except LocalEntryNotFoundError:
            # The hub does not answer and the cache lacks this file: do not wait for it again with the next name.
            offline = True
            return None
        except EntryNotFoundError:
            return None

    try:
        config = file(CONFIG)
        path = next((found for name in PREFERRED if (found := file(name)) is not None), None)
        if path is None and offline:
            folder = Path(snapshot_download(repository, revision=revision, cache_dir=cache, local_files_only=True))
            if not any(p.suffix in TORCH for p in folder.iterdir()):
                raise LocalEntryNotFoundError(f"{folder} holds no weights")
            path = choose(folder)
        elif path is None:  # one of several files may be meant: they are listed before any is downloaded
            listed = [name for name in list_repo_files(repository, revision=revision) if "/" not in name]
            path = file(_only(f"the hub's {given}", sorted(listed)))
            if path is None:
                raise LocalEntryNotFoundError(f"{given} cannot be downloaded")
        elif path.name.endswith(INDEX):
            _fetch_shards(path, file)
    except LocalEntryNotFoundError as error:
        raise CheckpointError(
            f"{given} is neither a file or folder here nor complete in the hub's cache, and the hub cannot be reached "
            f"(or HF_HUB_OFFLINE is set); download it where there is a connection, for example by `hf download "
            f"{repository}`, and give its folder"
        ) from error
    except RevisionNotFoundError as error:
        raise CheckpointError(f"{given}: the hub's repository {repository} has no revision {revision!r}") from error
    except RepositoryNotFoundError as error:
        raise CheckpointError(
            f"{given}: the hub has no repository {repository} that can be seen from here; a private or gated one needs "
            f"`hf auth login`"
        ) from error
    except (HFValidationError, HfHubHTTPError, OSError) as error:
        raise CheckpointError(f"{given} could not be fetched from the hub: {error}") from error
    # The cache keeps a commit's files under snapshots/<commit>/.
    commit = path.parent.name if path.parent.parent.name == "snapshots" else ""
    return Source(given, path, config, repository, commit)


def _fetch_shards(index: Path, file: Callable[[str], Path | None]) -> None:
    try:
        owners = dict(json.loads(index.read_text())["weight_map"])
    except (OSError, ValueError, KeyError, TypeError, RecursionError) as error:
        raise CheckpointError(f"{index} is no index of shards: {error!r}") from error
    for name in shard_names(index, owners):
        if file(name) is None:
            raise CheckpointError(f"{index} names the shard {name}, which neither the cache nor the hub gives")
