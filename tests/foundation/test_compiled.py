"""Kernels on disk go with the text of the kernel files of their room, and nothing is lost where there is no place for them."""

import os
import re
import time
from pathlib import Path

import pytest
from running import python

import posefuse
from posefuse.foundation import compiled
from posefuse.foundation.compiled import fingerprint, kernel_files, room_files

PACKAGE = Path(posefuse.__file__).parent
USE = """
import numpy as np
from posefuse.tracking.smooth_kernels import inverse3
out = np.empty((3, 3))
inverse3(np.diag([1.0, 2.0, 4.0]), out)
assert np.allclose(np.diag(out), [1.0, 0.5, 0.25])
"""


def use(cache: Path) -> None:
    done = python("-c", USE, POSEFUSE_CACHE=str(cache), PYTHONPATH=str(PACKAGE.parent))
    assert done.returncode == 0, done.stderr


def test_kernels_stand_only_where_their_changes_are_noticed() -> None:
    with_kernels = {path for path in PACKAGE.rglob("*.py") if re.search(r"^@(\w*kernel|njit|numba)\b", path.read_text(), re.M)}
    assert len(with_kernels) >= 5
    assert with_kernels <= set(kernel_files())
    # a change in another room would not be noticed
    for path in kernel_files():
        others = re.findall(r"^from posefuse\.(?!core|foundation)(\w+)", path.read_text(), re.M)
        assert {*others} <= {path.relative_to(PACKAGE).parts[0]}, path
    # nor one in the core, but for what is compiled from there
    compiled_too = {path for path in kernel_files() if re.search(r"= njit\(.*\)\(\w+\)", path.read_text())}
    assert [path.name for path in compiled_too] == ["lens.py"]
    assert "from posefuse.core.lens import" in compiled_too.pop().read_text()
    assert PACKAGE / "core" / "lens.py" in room_files("fusion")


def test_a_change_of_any_kernel_file_starts_a_new_folder(tmp_path: Path) -> None:
    (tmp_path / "a" / "kernels").mkdir(parents=True)
    files = [tmp_path / "a" / "kernels.py", tmp_path / "a" / "kernels" / "lens.py", tmp_path / "a" / "fast_kernels.py"]
    for path in files:
        path.write_text("x = 1")
    (tmp_path / "a" / "plain.py").write_text("x = 1")
    assert kernel_files(tmp_path) == sorted(files)
    seen = {fingerprint(files)}
    for path in files:
        path.write_text("x = 2")
        seen.add(fingerprint(files))
    assert len(seen) == 4


def test_compiled_forms_are_kept_in_the_users_cache(tmp_path: Path) -> None:
    use(tmp_path)
    folder = tmp_path / "kernels" / fingerprint(room_files("tracking"))
    assert list(folder.rglob("*inverse3*.nbi"))
    # no place to keep them is no error
    (tmp_path / "file").write_text("in the way")
    use(tmp_path / "file")


def test_compilation_is_announced_before_it_happens_and_once(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(compiled, "_folder", lambda: tmp_path)
    said: list[str] = []
    with compiled.compiling("joint angles", said.append):
        assert len(said) == 1 and "joint angles" in said[0]
    with compiled.compiling("joint angles", said.append):
        pass
    assert len(said) == 1
    with pytest.raises(KeyboardInterrupt), compiled.compiling("tracking", said.append):
        raise KeyboardInterrupt
    with compiled.compiling("tracking", said.append):
        pass
    assert len(said) == 3, "what was interrupted is not taken for compiled"


def test_where_nothing_can_be_kept_every_compilation_is_announced(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(compiled, "_folder", lambda: None)
    said: list[str] = []
    for _ in range(2):
        with compiled.compiling("tracking", said.append):
            pass
    assert len(said) == 2


def test_kernels_of_other_versions_stay_until_they_are_old(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setattr(compiled, "default_cache_dir", lambda: tmp_path)
    kernels = tmp_path / "kernels"
    for name, age_days in {"recent": 1, "old": 15}.items():
        (kernels / name).mkdir(parents=True)
        used_s = time.time() - 86400 * age_days
        os.utime(kernels / name, (used_s, used_s))
    own = compiled._folder.__wrapped__()
    assert {path.name for path in kernels.iterdir()} == {"recent", own.name}
