"""Who may enter the folders of a store."""

import os
import shutil
import stat

from gapmes.service.jobs.leases import Lease
from gapmes.service.jobs.spool import Spool
from gapmes.service.scenes.store import SceneStore


def test_a_new_store_is_for_its_user_alone(tmp_path):
    """Photographs lie in it, which a key keeps from others over HTTP; and a lock on its files would stop it."""
    before = os.umask(0o022)
    try:
        store = SceneStore(tmp_path / "above/scenes")
        Spool(store.root / ".jobs")
        Lease(store.root / ".processes").release()
        assert stat.S_IMODE(store.root.stat().st_mode) == 0o700
        assert stat.S_IMODE((store.root / ".jobs").stat().st_mode) == 0o700
        for remake in (
            lambda: SceneStore(store.root),
            lambda: Spool(store.root / ".jobs"),
            store.database.ensure_there,
        ):
            shutil.rmtree(store.root)
            remake()
            assert stat.S_IMODE(store.root.stat().st_mode) == 0o700
    finally:
        os.umask(before)


def test_a_store_that_is_there_keeps_its_mode(tmp_path):
    tmp_path.chmod(0o750)
    SceneStore(tmp_path)
    assert stat.S_IMODE(tmp_path.stat().st_mode) == 0o750
