"""Clock offsets of cameras on several machines, from what the oracle sees of a walking person."""

from pathlib import Path

import numpy as np
import pytest

from posefuse.app.live.clocks import agreed, blended, found_offsets, telling_points
from posefuse.detect import OracleNoise, oracle_views
from posefuse.files.truth import read_truth

OFFSET_S = np.array([0.0, 0.05, -0.02, 0.03])


def test_offsets_of_a_walking_person_are_found(demo_session: Path) -> None:
    truth = read_truth(demo_session / "truth" / "truth.npz")
    views = oracle_views(truth, OracleNoise(sigma_px=3.0), seed=4)
    told = telling_points(truth.skeleton)
    assert len(told) == 12
    kept = {
        name: [
            (int(t_ns + 1e9 * OFFSET_S[c]), views.xy_img[f, 0, c][told], views.score[f, 0, c][told])
            for f, t_ns in enumerate(truth.views[c].t_ns[:200])
        ]
        for c, name in enumerate(truth.rig.names)
    }
    found = found_offsets(truth.rig, kept)
    np.testing.assert_allclose([found[name] for name in truth.rig.names], OFFSET_S - OFFSET_S.mean(), atol=0.005)
    assert found_offsets(truth.rig, {name: views[:20] for name, views in kept.items()}) == {}


def test_one_wild_pair_does_not_bend_the_rest() -> None:
    pairs = [(i, j, OFFSET_S[j] - OFFSET_S[i]) for i in range(4) for j in range(i + 1, 4)]
    pairs[2] = (*pairs[2][:2], 0.28)
    found = agreed("abcd", pairs)
    np.testing.assert_allclose(list(found.values()), OFFSET_S - OFFSET_S.mean(), atol=1e-3)


def test_cameras_nothing_joins_are_left_out() -> None:
    assert set(agreed("abcde", [(0, 1, 0.1), (1, 2, 0.1), (3, 4, 0.2)])) == {"a", "b", "c"}
    assert agreed("ab", []) == {}


def test_findings_are_followed_and_their_mean_stays_zero() -> None:
    first = blended({}, {"a": -0.02, "b": 0.02})
    assert first == {"a": -0.02, "b": 0.02}
    second = blended(first, {"a": 0.0, "b": 0.0})
    assert second == pytest.approx({"a": -0.01, "b": 0.01})
    assert sum(blended(second, {"a": 0.3, "b": 0.1}).values()) == pytest.approx(0.0)
