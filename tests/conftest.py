"""Fixtures every room's tests share."""

import base64
import gzip
import importlib.util
import json
import os
import signal
import subprocess
from collections.abc import Callable, Generator, Iterator
from html.parser import HTMLParser
from pathlib import Path
from typing import Any

# before numpy is imported: tests run on all cores at once, and for matrices as small as theirs the threads of OpenBLAS
# wait for each other longer than they compute
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
os.environ.setdefault("OMP_NUM_THREADS", "1")
# curves need no window
os.environ.setdefault("MPLBACKEND", "Agg")

import built
import numpy as np
import pytest

from posefuse.core import SE3, SKELETONS, Camera, DependencyError, JointAngles, Pose3D, Rig, Skeleton
from posefuse.core.skeleton import COCO17
from posefuse.foundation.platform import default_cache_dir
from posefuse_sim.cameras import looking_at

_SHARED = Path(__file__).resolve().parents[2] / "shared" / "data"


def pytest_configure() -> None:
    """Heed Ctrl-C and hang-ups: a shell that runs the tests in the background has them ignored, and tests of them would wait."""
    if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
        signal.signal(signal.SIGINT, signal.default_int_handler)
    if hasattr(signal, "SIGHUP") and signal.getsignal(signal.SIGHUP) is signal.SIG_IGN:
        signal.signal(signal.SIGHUP, signal.SIG_DFL)


def is_of_missing_extra(error: DependencyError) -> bool:
    """Whether the package that the error is about is not installed; one that is there and does not work is no reason to skip."""
    cause = error.__context__
    return isinstance(cause, ModuleNotFoundError) and importlib.util.find_spec((cause.name or "").partition(".")[0]) is None


@pytest.hookimpl(wrapper=True)
def pytest_runtest_setup() -> Generator[None, object, object]:
    return (yield from skipped_without_extra())


@pytest.hookimpl(wrapper=True)
def pytest_runtest_call() -> Generator[None, object, object]:
    return (yield from skipped_without_extra())


def skipped_without_extra() -> Generator[None, object, object]:
    """A test that needs an extra which is not installed is skipped, and the line that posefuse prints names the extra."""
    try:
        return (yield)
    except DependencyError as error:
        if not is_of_missing_extra(error):
            raise
        pytest.skip(str(error))


@pytest.fixture(scope="session")
def shared_data() -> Path:
    """Real data next to the checkout; a fresh clone has none and skips, by name."""
    if not _SHARED.is_dir():
        pytest.skip("real data ../shared/data is not on this machine")
    return _SHARED


@pytest.fixture(scope="session")
def ring_rig() -> Callable[..., Rig]:
    """Builder of cameras on a circle that look at a point 1 m above its centre."""
    return _ring_rig


def _ring_rig(
    count: int,
    radius_m: float = 4.5,
    height_m: float = 2.2,
    size_wh: tuple[int, int] = (640, 480),
    distortion: tuple[float, ...] = (),
) -> Rig:
    focal = 0.9 * size_wh[0]
    intrinsics = np.array([[focal, 0, (size_wh[0] - 1) / 2], [0, focal, (size_wh[1] - 1) / 2], [0, 0, 1]])
    cameras = []
    for i in range(count):
        angle = 2 * np.pi * i / count + 0.3
        centre = np.array([radius_m * np.cos(angle), radius_m * np.sin(angle), height_m])
        pose = looking_at(centre, np.array([0, 0, 1.0]))
        cameras.append(
            Camera(name=f"cam{i:02d}", size_wh=size_wh, K=intrinsics, cam_from_world=pose, distortion=np.array(distortion))
        )
    return Rig(tuple(cameras), world_set_by="test")


@pytest.fixture(scope="session")
def demo_session() -> Path:
    """The bundled clip: four cameras, with its truth."""
    return Path(__file__).resolve().parents[1] / "examples" / "demo"


@pytest.fixture
def small_disk(tmp_path: Path) -> Iterator[Callable[[int], Path]]:
    """Mounts file systems of so many megabytes; where that is not allowed, the test is skipped."""
    places: list[Path] = []

    def mounted(size_mb: int) -> Path:
        place = tmp_path / f"disk{len(places)}"
        place.mkdir()
        command = ["mount", "-t", "tmpfs", "-o", f"size={size_mb}m", "posefuse-test", str(place)]
        try:
            done = subprocess.run(command, capture_output=True, timeout=10, check=False)
        except OSError as error:
            pytest.skip(f"no small file system can be mounted here ({error})")
        if done.returncode:
            pytest.skip(f"no small file system can be mounted here ({done.stderr.decode().strip()})")
        places.append(place)
        return place

    yield mounted
    for place in places:
        # lazily: a process of a test that failed may still hold a file there
        subprocess.run(["umount", "--lazy", str(place)], check=True, timeout=10)


@pytest.fixture(scope="session")
def models() -> None:
    """The networks are there, fetched once; without them and without a network the tests that look at images skip, by name."""

    from posefuse.core import ModelError
    from posefuse.detection import default_cards, fetch_all

    try:
        fetch_all(default_cards(), default_cache_dir())
    except ModelError as error:
        pytest.skip(f"the networks cannot be had: {error}")


@pytest.fixture(scope="session")
def read_page() -> Callable[[Path], "PageReader"]:
    """Parser of a page of `posefuse.formats.page`: checks that it is whole and stands alone, and says what it shows."""
    return PageReader


class PageReader(HTMLParser):
    """What a page shows.

    Attributes:
        text: all visible text. headings: texts of h1 to h4. tables: rows of cell texts. images: addresses.
        data: what the page's script draws, arrays in place of their numbers. classes: of every cell with one, by its text.
    """

    VOID = ("meta", "img", "input", "br")

    def __init__(self, path: Path) -> None:
        super().__init__()
        self.headings: list[str] = []
        self.tables: list[list[list[str]]] = []
        self.images: list[str] = []
        self.classes: dict[str, str] = {}
        self._open: list[tuple[str, dict[str, str | None]]] = []
        self._words: list[str] = []
        self._data = ""
        self.feed(path.read_text(encoding="utf-8"))
        assert self._open == []
        self.text = " ".join(self._words)
        self.data = _with_arrays(json.loads(gzip.decompress(base64.b64decode(self._data)))) if self._data else {}

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        found = dict(attrs)
        for key in ("src", "href"):
            assert (found.get(key) or "data:").startswith("data:"), f"the page needs another file: {found[key]}"
        if tag == "img":
            self.images.append(found["src"] or "")
        if tag == "table":
            self.tables.append([])
        if tag == "tr":
            self.tables[-1].append([])
        if tag in ("th", "td"):
            self.tables[-1][-1].append("")
        if tag in ("h1", "h2", "h3", "h4"):
            self.headings.append("")
        if tag not in self.VOID:
            self._open.append((tag, found))

    def handle_endtag(self, tag: str) -> None:
        assert self._open and self._open.pop()[0] == tag, f"</{tag}> closes something else"

    def handle_data(self, data: str) -> None:
        tag, found = self._open[-1] if self._open else ("", {})
        if found.get("id") == "page-data":
            self._data = data
        if tag in ("script", "style") or not data.strip():
            return
        self._words.append(data)
        if tag in ("th", "td"):
            self.tables[-1][-1][-1] += data
            if found.get("class"):
                self.classes[data] = found["class"] or ""
        if tag in ("h1", "h2", "h3", "h4"):
            self.headings[-1] += data

    def plot(self, title: str) -> dict[str, Any]:
        """The first plot of this title."""
        return next(plot for plot in self.data["plots"] if plot["title"] == title)


def _with_arrays(data: dict[str, Any]) -> dict[str, Any]:
    """The page's data with the arrays in place of their numbers."""
    arrays = [np.array(one, float) for one in data["arrays"]]
    for plot in data["plots"]:
        for series in plot["series"]:
            series |= {key: arrays[series[key]] for key in ("x", "y", "low", "high", "width") if key in series}
            if "width" in series:
                series["high"] = series["low"] + series.pop("width")
    return data


@pytest.fixture
def some_pose() -> Callable[..., Pose3D]:
    def make(people: int = 2, skeleton: Skeleton = SKELETONS["coco17"], seed: int = 0, t_ns: int = 1_700_000_000_123_456_789):
        rng = np.random.default_rng(seed)
        k = len(skeleton)
        half = rng.normal(size=(people, k, 3, 3)) * 0.02
        cov = half @ np.swapaxes(half, -1, -2)
        cov = (cov + np.swapaxes(cov, -1, -2)) / 2
        xyz = rng.normal(size=(people, k, 3))
        reproj, views = rng.uniform(0, 5, (people, k)), rng.integers(0, 9, (people, k))
        kind = rng.integers(0, 5, (people, k))
        lost = rng.random((people, k)) < 0.2
        xyz[lost], cov[lost], reproj[lost], views[lost], kind[lost] = np.nan, np.nan, np.nan, 0, 0
        return Pose3D(
            t_ns=t_ns,
            skeleton=skeleton,
            person_id=np.array([40, 7, 11][:people]),
            xyz_world=xyz,
            cov_world=cov,
            reproj_px=reproj,
            n_views=views,
            kind=kind,
        )

    return make


@pytest.fixture
def some_joints() -> JointAngles:
    rng = np.random.default_rng(3)
    return built.joint_angles(
        rng.normal(size=(2, 2, 4, 3)),
        joints=("left_hip", "left_knee", "left_ankle", "neck"),
        t_ns=np.array([4_000_000_000, 5_000_000_000]),
        person_id=[40, 7],
        segments=("pelvis", "left_thigh", "left_shank"),
        world_from_segment=SE3(rng.normal(size=(2, 2, 3, 4)), rng.normal(size=(2, 2, 3, 3))),
    )


@pytest.fixture
def standing() -> Callable[..., Pose3D]:
    """A person who stands at the origin and looks along +x; `moved` overrides keypoints."""

    def make(**moved: tuple[float, float, float]) -> Pose3D:
        xyz = built.straight()
        for name, place in moved.items():
            xyz[COCO17.index(name)] = place
        return built.pose(xyz[None], [1], 5_000_000_000)

    return make
