"""`import posefuse` shows what it offers, stays light, and everything it names exists and is documented."""

import inspect

import pytest
from running import python

import posefuse as pf
from posefuse.core import SKELETONS


def test_what_tab_completion_shows_is_what_is_exported() -> None:
    assert dir(pf) == sorted(pf.__all__)


@pytest.mark.parametrize("name", [name for name in pf.__all__ if name != "__version__"])
def test_every_public_name_exists_and_has_a_docstring(name: str) -> None:
    value = getattr(pf, name)
    assert inspect.getdoc(value)


def test_a_name_that_is_not_there_is_an_attribute_error() -> None:
    with pytest.raises(AttributeError, match="no attribute 'trakc'"):
        _ = pf.trakc


def test_functions_are_found_whatever_was_imported_before() -> None:
    code = "import posefuse.tracking, posefuse_sim, posefuse.evaluation.compare, posefuse as pf; print(callable(pf.track))"
    assert python("-c", code).stdout.strip() == "True"


def test_the_package_is_typed_for_its_users() -> None:
    from importlib.resources import files

    assert files("posefuse").joinpath("py.typed").is_file()


@pytest.mark.parametrize("name", sorted(name for name in pf.__all__ if inspect.isfunction(getattr(pf, name))))
def test_every_public_function_has_an_example_that_runs(name: str) -> None:
    """Those that need recordings, cameras or a network are only parsed here; `tests/api/test_gallery.py` runs such programs."""
    import doctest

    [test] = [one for one in doctest.DocTestFinder(recurse=False).find(getattr(pf, name), globs={}) if one.examples]
    assert doctest.DocTestRunner().run(test).failed == 0


def test_values_print_in_one_short_line(ring_rig) -> None:
    rig = ring_rig(4)
    pose = pf.Pose3D.empty(5, SKELETONS["blazepose33"])
    observed = pf.Detections2D.empty("cam00", 7, pose.skeleton)
    assert repr(rig).startswith("Rig(4 cameras: cam00, cam01, cam02, cam03; id ")
    assert repr(rig.cameras[0]) == "Camera(cam00, 640x480 px, pinhole)"
    assert repr(pose) == "Pose3D(at 5 ns, people (ids) [], Skeleton(blazepose33, 33 keypoints, 29 bones))"
    assert repr(observed) == "Detections2D(0 people in cam00 at 7 ns, Skeleton(blazepose33, 33 keypoints, 29 bones))"
    assert repr(pf.PoseSequence.from_poses([pose])).startswith("PoseSequence(1 time steps, people (ids) [], Skeleton(")
